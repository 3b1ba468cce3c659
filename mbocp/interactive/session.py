"""The live page: `live`."""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp.interactive.handles import JointHandle, PoseHandle, joint_handles, pose_handles
from mbocp.interactive.resolver import Reply, Resolver, Wish, weight_keys
from mbocp.problem import Problem
from mbocp.solution import Solution
from mbocp.solution.from_files import problem_from
from mbocp.solving import solve
from mbocp.view.live.live_scene import ACCENT, LiveScene, viser_module
from mbocp.view.live.server import page_server
from mbocp.view.marks import marks_of
from mbocp.view.motion_samples import PlacementSamples, sample_motion

_FRAMES_PER_SECOND = 30.0
_SHOWS_END = 0.8  # [s] for which the end is shown after the goal has moved
_STAYS_AT_END = 0.8  # [s] before the motion starts again
_MOST_SLIDERS = 24
_DECADES = 2.0  # by which a weight is turned up or down
_SHORTEST, _LONGEST = 0.25, 4.0  # durations, as parts of the problem's
_HANDLE = 0.16  # size of a handle, in sizes of the scene
_HEIGHT = 640  # of the page in a notebook [pixel]


def live(
    problem: Problem | str | Path,
    *,
    warm_start: Solution | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    rate: float = 20.0,
    time_limit: float = 2.0,
) -> Live:
    """Solve a problem and show it on a page where its goal can be dragged; it is solved again meanwhile.

    Parameters
    ----------
    problem : Problem, str or Path
    warm_start : Solution, optional
        Where the first solve begins.
    host : str
        Address at which the page is served; by default for this machine alone.
    port : int
        The first port that is tried.
    rate : float
        Solves a second, at most [1/s].
    time_limit : float
        Longest time of a solve, but for the first [s].

    Returns
    -------
    Live
        The page, which is served until `close`; in a notebook it shows itself.

    Raises
    ------
    ReplayError
        If viser is not installed: ``pip install 'mbocp[live]'``.
    MbocpError
        If the problem is not well posed.
    """
    viser_module()
    made = problem_from(problem)
    return Live(
        made, solve(made, warm_start=warm_start), host=host, port=port, rate=rate, time_limit=time_limit
    )


class Live:
    """A page with a robot, its motion, and handles of its goal; use it in a `with` block, or `close` it.

    Parameters
    ----------
    problem : Problem
    solution : Solution
        Its solution.
    host, port, rate, time_limit
        As of `live`.

    Attributes
    ----------
    answer : Reply
        The last one, good or not.
    """

    def __init__(
        self,
        problem: Problem,
        solution: Solution,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        rate: float = 20.0,
        time_limit: float = 2.0,
    ) -> None:
        self._asked, self._lock = problem, threading.RLock()
        self.answer = Reply(
            Wish(), problem, solution, solution.wall_time_s, "" if solution.converged else solution.advice
        )
        self._problem, self._solution, self._wish = problem, solution, Wish()
        self._q_goal = np.array(problem.goal.q if problem.goal.says_where else solution.qs[-1])
        self._server = page_server(host, port, problem.name)
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="medium", brand_color=ACCENT
        )
        self._scene = LiveScene(
            self._server,
            problem.robot,
            self._motion(),
            goals=_find_fixed_goals(problem),
            marks=marks_of(problem),
        )
        self._time, self._shown, self._end_until, self._is_dragged = 0.0, 0.0, 0.0, False
        self._closed = threading.Event()
        self._add_controls()
        self._add_pose_handles()
        self._resolver = Resolver(problem, solution, self._take, rate=rate, time_limit=time_limit)
        self._player = threading.Thread(target=self._play, name="mbocp live player", daemon=True)
        self._player.start()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" style="width: 100%; height: {_HEIGHT}px; border: 0"></iframe>'

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    @property
    def problem(self) -> Problem:
        """The last problem that was solved."""
        return self._problem

    @property
    def solution(self) -> Solution:
        """Its solution: the motion that is shown."""
        return self._solution

    def ask(self, wish: Wish) -> None:
        """Ask for something else, as the page's handles do."""
        with self._lock:
            self._wish = wish
        self._resolver.ask(wish)

    def wait_until_idle(self, timeout: float | None = None) -> bool:
        """Block until all is answered; False if that takes longer than the timeout [s]."""
        return self._resolver.wait_until_idle(timeout)

    def wait_until_closed(self) -> None:
        """Block until the page is closed, or until something fails in its threads, which is raised."""
        while not self._closed.wait(0.2):
            if self._resolver.error is not None:
                raise self._resolver.error

    def close(self) -> None:
        """Stop serving the page."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._resolver.close()
        self._player.join()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    # The motion

    def _motion(self) -> PlacementSamples:
        solution = self._solution
        return sample_motion(self._asked.robot.model, solution.t, solution.qs)

    def _take(self, answer: Reply) -> None:
        """Show an answer."""
        with self._lock:
            self.answer = answer
            if answer.is_good and answer.problem is not None and answer.solution is not None:
                self._problem, self._solution = answer.problem, answer.solution
                goal = answer.problem.goal
                self._q_goal = np.array(goal.q if goal.says_where else answer.solution.qs[-1])
                self._scene.show(self._motion())
                duration = self._scene.motion.duration
                self._clock.value, self._clock.max = 0.0, max(duration, 1e-3)
                self._set_time(min(self._time, duration))
                self._place_handles()
            self._tell()

    def _play(self) -> None:
        before = time.perf_counter()
        while not self._closed.wait(1.0 / _FRAMES_PER_SECOND):
            now = time.perf_counter()
            with self._lock:
                self._move_on(now, now - before)
            before = now

    def _move_on(self, now: float, passed: float) -> None:
        duration = self._scene.motion.duration
        if now < self._end_until or self._is_dragged:
            self._set_time(duration)
        elif self._plays.value and duration > 0.0 and self._clock.value == self._shown:  # not moved by hand
            moved = self._time + passed * self._speed.value
            self._set_time(0.0 if moved > duration + _STAYS_AT_END * self._speed.value else moved)

    def _set_time(self, moment: float) -> None:
        """Show the pose at a time; after the end that of the end."""
        self._time = moment
        self._shown = min(moment, self._scene.motion.duration)
        self._scene.move_to(self._shown)
        self._clock.value = self._shown

    # The page

    def _add_controls(self) -> None:
        gui, duration = self._server.gui, self._scene.motion.duration
        self._length: Any = None
        self._weights: list[Any] = []
        self._status = gui.add_markdown("")
        self._tell()
        with gui.add_folder("Motion"):
            self._plays = gui.add_checkbox("Play", True)
            self._speed = gui.add_slider("Speed", 0.1, 2.0, 0.1, 1.0)
            self._clock = gui.add_slider("Time [s]", 0.0, max(duration, 1e-3), 1e-3, 0.0)
            self._clock.on_update(self._scrub)
            if not (
                self._asked.timeline.has_free_lengths or self._asked.phase or self._asked.lengths is not None
            ):
                low, high = _SHORTEST * self._asked.duration, _LONGEST * self._asked.duration
                length = gui.add_slider("Duration [s]", low, high, 1e-2, self._asked.duration)
                length.on_update(lambda event: self._ask_for(event, duration=float(length.value)))
                self._length = length
        keys = weight_keys(self._asked)
        if len(keys) > 1:
            with gui.add_folder("Weights"):
                for key in keys:
                    self._add_weight(key)
        self._sliders = joint_handles(self._asked)[:_MOST_SLIDERS]
        self._values: list[Any] = []
        if self._sliders:
            with gui.add_folder("Goal", expand_by_default=True):
                self._values = [self._add_joint(joint) for joint in self._sliders]
        back = gui.add_button("Reset")
        back.on_click(lambda _: self._back())

    def _add_weight(self, key: str) -> None:
        gui = self._server.gui
        slider = gui.add_slider(
            key, -_DECADES, _DECADES, 0.1, 0.0, hint="decades by which the weight changes"
        )
        factor_text = gui.add_markdown(_describe_factor(1.0))

        def take_weight(event: Any) -> None:
            factor = 10.0 ** float(slider.value)
            factor_text.content = _describe_factor(factor)
            with self._lock:
                factors = {**self._wish.factors, key: factor}
            self._ask_for(event, factors=factors)

        slider.on_update(take_weight)
        self._weights.append(slider)

    def _add_joint(self, joint: JointHandle) -> Any:
        step = (joint.upper - joint.lower) / 1000.0 or 1e-3
        value = joint.value(self._q_goal)
        slider = self._server.gui.add_slider(joint.name, joint.lower, joint.upper, step, value)

        def take_angle(event: Any) -> None:
            with self._lock:
                q = joint.move(self._q_goal if self._wish.q is None else self._wish.q, float(slider.value))
            self._ask_for(event, goal=True, q=q, tool=None)

        slider.on_update(take_angle)
        return slider

    def _add_pose_handles(self) -> None:
        self._poses: list[tuple[PoseHandle, Any]] = []
        for number, pose in enumerate(pose_handles(self._asked)):
            handle = self._server.scene.add_transform_controls(
                f"/handles/{number}",
                scale=_HANDLE * self._scene.size,
                active_axes=pose.axes,
                disable_axes=not pose.slides,
                disable_sliders=not pose.slides,
                disable_rotations=not pose.turns,
                depth_test=False,
            )
            handle.on_update(self._handle_drag(pose, handle))
            self._poses.append((pose, handle))
        self._place_handles()

    def _handle_drag(self, pose: PoseHandle, handle: Any) -> Callable[[Any], None]:
        def drag(event: Any) -> None:
            with self._lock:
                self._is_dragged = event.phase != "end"
                turn = pin.SE3(self._scene.turn, np.zeros(3))
                wish = pose.move(self._wish, turn.actInv(_placement(handle)), self._q_goal)
                self._end_until = time.perf_counter() + _SHOWS_END
            if event.phase != "start":
                self.ask(wish)

        return drag

    def _place_handles(self) -> None:
        """Put handles where the goal is, unless one of them is held."""
        turn = pin.SE3(self._scene.turn, np.zeros(3))
        for pose, handle in () if self._is_dragged else self._poses:
            placed = turn * pose.placement(self._problem.goal, self._q_goal)
            handle.position = placed.translation
            handle.wxyz = np.roll(pin.Quaternion(placed.rotation).coeffs(), 1)
        for joint, slider in zip(self._sliders, self._values, strict=True):
            value = float(np.clip(joint.value(self._q_goal), joint.lower, joint.upper))
            if abs(value - slider.value) > slider.step:
                slider.value = value

    def _ask_for(self, event: Any, *, goal: bool = False, **changes: Any) -> None:
        """Ask for what a control says; what the program has set is no wish."""
        if event.client is None:
            return
        with self._lock:
            wish = replace(self._wish, **changes)
            if goal:
                self._end_until = time.perf_counter() + _SHOWS_END
        self.ask(wish)

    def _scrub(self, event: Any) -> None:
        if event.client is None:
            return
        with self._lock:
            self._plays.value = False
            self._set_time(min(float(self._clock.value), self._scene.motion.duration))

    def _back(self) -> None:
        """Undo all that was asked for."""
        for slider in self._weights:
            slider.value = 0.0
        if self._length is not None:
            self._length.value = self._asked.duration
        self.ask(Wish())

    def _tell(self) -> None:
        answer = self.answer
        mark = "**" if answer.is_good else "**⚠ "
        shown = "is the last that converged" if self._solution.converged else "has not converged"
        rest = "" if answer.is_good else f"\n\nThe motion that is shown {shown}."
        words = f"\n\n{answer.words}" if answer.words else ""
        self._status.content = f"{mark}{answer.state}**{words}{rest}"


def _find_fixed_goals(problem: Problem) -> list[Any]:
    """Poses of goals that have no handle."""
    if not problem.goals:
        return []
    return [frame.target for _, member in problem.members for frame in member.goal.poses]


def _placement(handle: Any) -> pin.SE3:
    w, x, y, z = handle.wxyz
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(handle.position))


def _describe_factor(factor: float) -> str:
    """Say by what a weight of the problem is multiplied."""
    return f"times {factor:.3g}"
