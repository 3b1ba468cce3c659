"""Messages of ROS as plain classes, a controller that follows motions on a clock, and an rclpy of both."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from mbocp_ros.messages import MessageClasses


class Time:
    def __init__(self, sec: int = 0, nanosec: int = 0) -> None:
        self.sec, self.nanosec = sec, nanosec

    @property
    def seconds(self) -> float:
        return self.sec + 1e-9 * self.nanosec


class Duration(Time):
    pass


class JointTrajectoryPoint:
    def __init__(self) -> None:
        self.positions: list[float] = []
        self.velocities: list[float] = []
        self.accelerations: list[float] = []
        self.effort: list[float] = []
        self.time_from_start: Any = Duration()


class JointTrajectory:
    def __init__(self) -> None:
        self.header = SimpleNamespace(stamp=Time())
        self.joint_names: list[str] = []
        self.points: list[Any] = []


class JointState:
    def __init__(self, name: list[str], position: list[float], velocity: list[float]) -> None:
        self.name, self.position, self.velocity = name, position, velocity


class Result:
    INVALID_GOAL = -1

    def __init__(self, error_code: int = 0, error_string: str = "") -> None:
        self.error_code, self.error_string = error_code, error_string


class FollowJointTrajectory:
    Result = Result

    class Goal:
        def __init__(self) -> None:
            self.trajectory: Any = JointTrajectory()


CLASSES = MessageClasses(JointTrajectory, JointTrajectoryPoint, Duration, Time)


def goal_message(**positions: float) -> JointTrajectory:
    message, point = JointTrajectory(), JointTrajectoryPoint()
    message.joint_names, point.positions = list(positions), list(positions.values())
    message.points = [point]
    return message


class Future:
    """Done from the start, or when `finish` is called."""

    def __init__(self, value: Any = None) -> None:
        self._value, self._callbacks = value, []  # type: Any, list[Callable[[Any], None]]
        self._is_done = value is not None

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
        if self._is_done:
            callback(self)
        else:
            self._callbacks.append(callback)

    def result(self) -> Any:
        return self._value

    def finish(self, value: Any) -> None:
        self._value, self._is_done = value, True
        for callback in self._callbacks:
            callback(self)


class Controller:
    """An action client and its server in one: it is done at the end of the last trajectory it was sent."""

    def __init__(self, *, accepts: bool = True, status: int = 4) -> None:
        self.received: list[Any] = []
        self._accepts, self._status = accepts, status
        self._results: list[Future] = []

    def send_goal_async(self, goal: Any) -> Future:
        if not self._accepts:
            return Future(SimpleNamespace(accepted=False))
        for result in self._results:  # as a controller does: the one before is given up
            result.finish(SimpleNamespace(status=5, result=Result(-1, "another goal came")))
        trajectory, result = goal.trajectory, Future()
        self.received.append(trajectory)
        self._results = [result]
        end = trajectory.header.stamp.seconds + trajectory.points[-1].time_from_start.seconds
        answer = SimpleNamespace(status=self._status, result=Result(0 if self._status == 4 else -4))

        def end_of_motion() -> None:
            if self._results == [result]:
                self._results = []
                result.finish(answer)

        timer = threading.Timer(max(end - time.time(), 0.0), end_of_motion)
        timer.daemon = True
        timer.start()
        return Future(SimpleNamespace(accepted=True, get_result_async=lambda: result))


class GoalHandle:
    """What an action server gives to its execute callback."""

    def __init__(self, trajectory: Any) -> None:
        self.request = SimpleNamespace(trajectory=trajectory)
        self.is_cancel_requested, self.state = False, ""

    def succeed(self) -> None:
        self.state = "succeeded"

    def abort(self) -> None:
        self.state = "aborted"

    def canceled(self) -> None:
        self.state = "canceled"


class Node:
    def __init__(self, **parameters: Any) -> None:
        self.parameters, self.words = parameters, []  # type: dict[str, Any], list[str]
        self.subscriptions: dict[str, Callable[[Any], None]] = {}
        self.is_destroyed = False

    def declare_parameter(self, name: str, value: Any) -> None:
        self.parameters.setdefault(name, value)

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.parameters[name])

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self.words.append, warning=self.words.append, error=self.words.append)

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=time.time_ns()))

    def create_subscription(self, kind: Any, topic: str, callback: Any, depth: int, **_: Any) -> None:
        self.subscriptions[topic] = callback

    def destroy_node(self) -> None:
        self.is_destroyed = True


def fake_modules(node: Node, controller: Controller, run: Callable[[Any], None]) -> dict[str, ModuleType]:
    """Modules that `main` imports; `run` takes the place of spinning, with the action server."""
    servers: list[Any] = []

    def serve(*words: Any, **callbacks: Any) -> Any:
        servers.append(SimpleNamespace(name=words[2], destroy=lambda: None, **callbacks))
        return servers[-1]

    names = {
        "rclpy": {
            "init": lambda: None,
            "create_node": lambda name: node,
            "spin": lambda *_: run(servers[0]),
            "try_shutdown": lambda: None,
        },
        "rclpy.action": {
            "ActionClient": lambda *_, **__: controller,
            "ActionServer": serve,
            "CancelResponse": SimpleNamespace(ACCEPT="accept"),
        },
        "rclpy.callback_groups": {"ReentrantCallbackGroup": object},
        "rclpy.executors": {
            "MultiThreadedExecutor": lambda threads: None,
            "ExternalShutdownException": type("ExternalShutdownException", (Exception,), {}),
        },
        "builtin_interfaces": {},
        "builtin_interfaces.msg": {"Duration": Duration, "Time": Time},
        "control_msgs": {},
        "control_msgs.action": {"FollowJointTrajectory": FollowJointTrajectory},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"JointState": JointState},
        "trajectory_msgs": {},
        "trajectory_msgs.msg": {
            "JointTrajectory": JointTrajectory,
            "JointTrajectoryPoint": JointTrajectoryPoint,
        },
    }
    modules = {}
    for name, content in names.items():
        modules[name] = ModuleType(name)
        vars(modules[name]).update(content)
    return modules


def rows(message: Any, name: str) -> np.ndarray:
    """Values of all points of a trajectory."""
    return np.array([getattr(point, name) for point in message.points])


def times(message: Any) -> np.ndarray:
    return np.array([point.time_from_start.seconds for point in message.points])
