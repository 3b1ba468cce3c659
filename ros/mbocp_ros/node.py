"""The node: an action "move" that plans a motion, has a controller follow it, and stops it when cancelled."""

from __future__ import annotations

import contextlib
import threading
from typing import Any

from mbocp.exceptions import MbocpError, ProblemError
from mbocp_ros.messages import MessageClasses, goal_positions, joint_state, trajectory_message
from mbocp_ros.planner import Motion, load_planner

_AHEAD = 0.05  # [s] that a motion begins after it is sent: controllers have it by then
_PERIOD = 0.01  # [s] between looks at whether a goal is cancelled
_FRESH = 1.0  # [s] that a joint state may be old
_ANSWER = 5.0  # [s] that the controller has to accept a motion
_PARAMETERS = {
    "problem": "",  # path of the problem file
    "controller": "/joint_trajectory_controller/follow_joint_trajectory",
    "time_limit": 10.0,  # [s] of a solve
    "rest": 0.01,  # [rad/s, m/s] below which a joint is at rest
    "efforts": False,  # whether motions have efforts, for controllers of that command interface
    "reaction": 0.5,  # [s] that the solve of a stop may take; doubled where that is too short
}
_SUCCEEDED = 4  # action_msgs/msg/GoalStatus


class Mover:
    """What the node does, with rclpy's objects given.

    Parameters
    ----------
    node : rclpy.node.Node
        With the parameters declared by `main`.
    action : type
        control_msgs/action/FollowJointTrajectory.
    classes : MessageClasses
    client : rclpy.action.ActionClient
        Of the controller.
    """

    def __init__(self, node: Any, action: Any, classes: MessageClasses, client: Any) -> None:
        values = {name: node.get_parameter(name).value for name in _PARAMETERS}
        if not values["problem"]:
            raise ProblemError("problem: the parameter is missing; give it the path of a problem file")
        self._node, self._action, self._classes, self._client = node, action, classes, client
        self._reaction, self._has_efforts = float(values["reaction"]), bool(values["efforts"])
        self._planner = load_planner(values["problem"], float(values["time_limit"]), float(values["rest"]))
        self._state: tuple[int, Any] | None = None
        self._is_busy = threading.Lock()

    def read_state(self, message: Any) -> None:
        """Keep the last JointState that has a joint of the robot: several nodes may publish them."""
        if set(message.name) & set(self._planner.joints):
            self._state = self._now(), message

    def move(self, handle: Any) -> Any:
        """Execute a goal, to its end or to its stop; the result says why where it is refused."""
        result = self._action.Result()
        if not self._is_busy.acquire(blocking=False):
            return self._abort(handle, result, "move: another motion is under way; cancel it first")
        try:
            return self._follow(handle, result)
        except MbocpError as error:
            return self._abort(handle, result, str(error))
        finally:
            self._is_busy.release()

    def _follow(self, handle: Any, result: Any) -> Any:
        goal = goal_positions(handle.request.trajectory)
        came, state = self._state or (0, None)
        if state is None or self._now() - came > 1e9 * _FRESH:
            raise ProblemError(f"start: no joint states have come within {_FRESH:g} s")
        motion = self._planner.plan(*joint_state(state), goal)
        if handle.is_cancel_requested:
            handle.canceled()
            return result
        start = self._now() + round(_AHEAD * 1e9)
        done = self._send(motion, start)
        is_stopped = False
        while not done.is_set():
            if handle.is_cancel_requested and not is_stopped:
                is_stopped = True
                stop = self._stop(motion, start)
                if stop is not None:
                    done, result.error_string = self._send(stop, start), stop.words
            done.wait(_PERIOD)
        answer = done.answer
        if answer.status != _SUCCEEDED:
            words = answer.result.error_string or f"the controller ended with status {answer.status}"
            return self._abort(handle, result, words, answer.result.error_code)
        (handle.canceled if is_stopped else handle.succeed)()
        return result

    def _stop(self, motion: Motion, start: int) -> Motion | None:
        """The stop of a motion; None where none is found before its end, which it then runs to."""
        reaction = self._reaction
        while True:
            at = 1e-9 * (self._now() - start) + reaction
            try:
                stop = self._planner.stop(motion, at, time_limit=0.9 * reaction)
            except MbocpError as error:
                self._node.get_logger().warning(f"no stop from {at:.3g} s: {error}")
                if at >= motion.duration:
                    return None
            else:
                if 1e-9 * (self._now() - start) < stop.begin:
                    if stop.words:
                        self._node.get_logger().warning(f"the stop leaves limits: {stop.words}")
                    return stop
            reaction *= 2.0

    def _send(self, motion: Motion, start: int) -> _Following:
        goal = self._action.Goal()
        goal.trajectory = trajectory_message(motion, start, self._classes, has_efforts=self._has_efforts)
        following = _Following()
        self._client.send_goal_async(goal).add_done_callback(following.take_handle)
        if not following.is_answered.wait(_ANSWER):
            raise ProblemError(f"controller: no answer in {_ANSWER:g} s")
        if not following.is_accepted:
            raise ProblemError("controller: it refused the motion")
        return following

    def _abort(self, handle: Any, result: Any, words: str, code: int | None = None) -> Any:
        self._node.get_logger().error(words)
        result.error_code = self._action.Result.INVALID_GOAL if code is None else code
        result.error_string = words
        handle.abort()
        return result

    def _now(self) -> int:
        """Time by the clock of the node [ns]."""
        return int(self._node.get_clock().now().nanoseconds)


class _Following(threading.Event):
    """Set when the controller is done; `answer` has its status and result."""

    def __init__(self) -> None:
        super().__init__()
        self.is_answered, self.is_accepted = threading.Event(), False
        self.answer: Any = None

    def take_handle(self, future: Any) -> None:
        """Take the controller's yes or no."""
        handle = future.result()
        self.is_accepted = bool(handle.accepted)
        if self.is_accepted:
            handle.get_result_async().add_done_callback(self._take_answer)
        self.is_answered.set()

    def _take_answer(self, future: Any) -> None:
        self.answer = future.result()
        self.set()


def main() -> None:
    """Run the node until it is ended."""
    import rclpy
    from builtin_interfaces.msg import Duration, Time
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient, ActionServer, CancelResponse
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    rclpy.init()
    node = rclpy.create_node("mbocp_move")
    for name, value in _PARAMETERS.items():
        node.declare_parameter(name, value)
    group = ReentrantCallbackGroup()  # a goal is executed while states, cancels and answers come in
    controller = node.get_parameter("controller").value
    client = ActionClient(node, FollowJointTrajectory, controller, callback_group=group)
    classes = MessageClasses(JointTrajectory, JointTrajectoryPoint, Duration, Time)
    mover = Mover(node, FollowJointTrajectory, classes, client)
    node.create_subscription(JointState, "joint_states", mover.read_state, 10, callback_group=group)
    server = ActionServer(
        node,
        FollowJointTrajectory,
        "move",
        execute_callback=mover.move,
        cancel_callback=lambda _: CancelResponse.ACCEPT,
        callback_group=group,
    )
    node.get_logger().info("ready")
    try:
        with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
            rclpy.spin(node, MultiThreadedExecutor(4))
    finally:
        server.destroy()
        node.destroy_node()
        rclpy.try_shutdown()
