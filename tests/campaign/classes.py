"""Classes of tasks: a robot, a scheme, a form of the cost; one shape of functions each."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CLASSES", "QUICK", "TaskClass"]


@dataclass(frozen=True)
class TaskClass:
    """What the tasks of a class have in common.

    Attributes
    ----------
    motion : str
        How a task is made, so that it is feasible: "geodesic", "bend" and "loops" lead from rest to rest,
        "rollout" ends where a simulation with random controls ends.
    cost : str
        "velocity" (and effort), "effort" alone, "tracking", "rate", "penalty".
    spread : float
        How far tasks go [rad, m].
    path : str
        Kind of a path constraint.
    asks : str
        What else is asked, words of `tests.campaign.asked.ASKS` joined by "+".
    share : float
        Of the tasks.
    """

    name: str
    family: str
    robot: str
    scheme: str = "se1"
    motion: str = "geodesic"
    cost: str = "velocity"
    coordinates: str = "joint"
    spread: float = 2.0
    limits: bool = True
    path: str = ""
    asks: str = ""
    share: float = 1.0
    steps: tuple[int, ...] = (30, 45, 60, 80)
    duration: tuple[float, float] = (0.8, 3.0)


def _c(name: str, family: str, robot: str, **others: object) -> TaskClass:
    return TaskClass(name, family, robot, **others)  # type: ignore[arg-type]


_ROLL = {"motion": "rollout"}
CLASSES: dict[str, TaskClass] = {
    c.name: c
    for c in (
        _c("ur5", "arm", "ur5", share=2),
        _c("ur5_effort", "arm", "ur5", cost="effort", share=2),
        _c("ur5_midpoint", "arm", "ur5", scheme="midpoint"),
        _c("ur5_semi_implicit", "arm", "ur5", scheme="semi_implicit_euler"),
        _c("ur5_rk4", "arm", "ur5", scheme="rk4", motion="rollout"),
        _c("ur5_table", "arm, path", "ur5", path="position"),
        _c("panda", "arm", "panda", share=2),
        _c("panda_effort", "arm", "panda", cost="effort", share=2),
        _c("kinova", "arm", "kinova", share=2, duration=(1.0, 3.0)),
        _c("kinova_effort", "arm", "kinova", cost="effort", share=2, duration=(1.0, 3.0)),
        _c("tiny_arm", "scale", "tiny_arm"),
        _c("huge_arm", "scale", "huge_arm"),
        _c("light_arm", "scale", "light_arm", cost="effort"),
        _c("heavy_arm", "scale", "heavy_arm", cost="effort"),
        _c("double_pendulum", "pendulum", "double_pendulum", share=2, spread=3.0),
        _c("double_pendulum_effort", "pendulum", "double_pendulum", cost="effort", share=2, spread=3.0),
        _c("double_pendulum_midpoint", "pendulum", "double_pendulum", scheme="midpoint", cost="rate"),
        _c("double_pendulum_se2", "pendulum", "double_pendulum", scheme="se2", cost="tracking"),
        _c("double_pendulum_rkf5", "pendulum", "double_pendulum", scheme="rkf5", **_ROLL),
        _c("double_pendulum_ring", "pendulum, path", "double_pendulum", path="distance"),
        _c("double_pendulum_slow", "pendulum, path", "double_pendulum", path="speed"),
        _c("double_pendulum_penalty", "pendulum", "double_pendulum", cost="penalty", scheme="midpoint"),
        _c("acrobot", "underactuated", "acrobot", cost="effort", share=2, **_ROLL),
        _c("acrobot_midpoint", "underactuated", "acrobot", scheme="midpoint", share=2, **_ROLL),
        _c("cart_pendulum", "underactuated", "cart_pendulum", cost="effort", **_ROLL),
        _c("elastic_cart", "underactuated", "elastic_cart", cost="effort", scheme="midpoint", **_ROLL),
        _c("elastic_pendulum", "pendulum", "elastic_pendulum", cost="effort"),
        _c("rigid_pendulum", "pendulum", "rigid_pendulum", scheme="se2", cost="effort", **_ROLL),
        _c("drone", "drone", "drone", spread=1.0, share=2),
        _c("drone_effort", "drone", "drone", spread=1.0, cost="effort", share=2),
        _c("drone_rk4", "drone", "drone", scheme="rk4", limits=False, spread=1.0, **_ROLL),
        _c("quadrotor", "drone", "quadrotor", duration=(0.8, 2.0), **_ROLL),
        _c("standing", "legged", "standing", motion="loops", spread=0.08, share=0.5, steps=(20, 30, 40)),
        _c("four_bar", "loop", "four_bar", motion="loops", share=2, duration=(0.8, 2.0)),
        _c("four_bar_midpoint", "loop", "four_bar", scheme="midpoint", cost="effort", **_ROLL),
        _c("five_bar", "loop", "five_bar", motion="loops", spread=1.0),
        _c("five_bar_heun", "loop", "five_bar", scheme="heun", share=0.25, steps=(15, 20), **_ROLL),
        _c("slider_crank", "loop", "slider_crank", motion="loops", spread=2.0),
        _c("parallelogram_arm", "loop", "parallelogram_arm", motion="loops", spread=0.5),
        _c("delta", "loop", "delta", motion="loops", spread=0.5, share=0.5, steps=(20, 30, 40)),
        _c("stewart", "loop", "stewart", motion="loops", spread=0.1, share=0.5, steps=(20, 30, 40)),
        _c(
            "double_pendulum_natural",
            "natural",
            "double_pendulum_undamped",
            coordinates="natural",
            cost="effort",
        ),
        _c("ur5_natural", "natural", "ur5", coordinates="natural", cost="effort", share=0.5, spread=1.5),
        _c("four_bar_natural", "natural", "four_bar", coordinates="natural", cost="effort", motion="loops"),
        _c("ur5_span", "span", "ur5", asks="span", share=0.5),
        _c("double_pendulum_span", "span", "double_pendulum", asks="span"),
        _c("double_pendulum_gate", "equation", "double_pendulum", asks="gate", spread=3.0),
        _c("ur5_gate", "equation", "ur5", scheme="midpoint", asks="gate", share=0.5),
        _c("elastic_pendulum_plane", "equation", "elastic_pendulum", cost="effort", asks="plane"),
        _c("elastic_pendulum_line", "equation", "elastic_pendulum", cost="effort", asks="line"),
        _c("drone_level", "equation", "drone", asks="kept", spread=1.0),
        _c("ur5_cone", "span", "ur5", asks="cone", share=0.5),
        _c("drone_spin", "span", "drone", asks="spin", spread=1.0),
        _c("free_rk4", "free duration", "double_pendulum", scheme="rk4", asks="free", **_ROLL),
        _c("rates_heun", "rates", "double_pendulum", scheme="heun", asks="rates", **_ROLL),
        _c("double_pendulum_via", "via point", "double_pendulum", asks="via"),
        _c("ur5_via", "via point", "ur5", asks="via_pose", share=0.5),
        _c("ur5_via_box", "via point", "ur5", asks="via_box+via", share=0.5),
        _c("double_pendulum_via_box", "via point", "double_pendulum", scheme="midpoint", asks="via_box"),
        _c("ur5_pose", "goal of a frame", "ur5", asks="reach", share=0.5),
        _c("double_pendulum_pose", "goal of a frame", "double_pendulum", asks="reach"),
        _c("double_pendulum_rates", "rates", "double_pendulum", asks="rates"),
        _c("ur5_rates", "rates", "ur5", asks="rates", share=0.5),
        _c("double_pendulum_free", "free duration", "double_pendulum", cost="effort", asks="free"),
        _c("double_pendulum_fast", "free duration", "double_pendulum", scheme="midpoint", asks="free+rates"),
        _c("ur5_free", "free duration", "ur5", cost="effort", asks="free+reach", share=0.5),
        _c("two_arms", "joined parts", "two_arms", motion="loops", spread=0.1, share=0.5, steps=(20, 30)),
        _c("double_pendulum_times", "free times", "double_pendulum", asks="times"),
        _c("double_pendulum_stages", "free times", "double_pendulum", cost="effort", asks="free+times"),
        _c("ur5_times", "free times", "ur5", scheme="midpoint", asks="times", share=0.5),
        _c("elastic_pendulum_follow", "followed path", "elastic_pendulum", cost="effort", asks="follow"),
        _c("double_pendulum_follow", "followed path", "double_pendulum", asks="follow"),
        _c("ur5_follow", "followed path", "ur5", asks="follow", share=0.5),
        _c("crate", "obstacles", "guarded", motion="bend", asks="crate"),
        _c("clutter", "obstacles", "guarded", scheme="midpoint", motion="bend", asks="clutter"),
        _c("ur5_gauss2", "order four", "ur5", scheme="gauss2", **_ROLL),
        _c("panda_gauss2", "order four", "panda", scheme="gauss2", share=0.5, **_ROLL),
        _c("double_pendulum_gauss2", "order four", "double_pendulum", scheme="gauss2", share=2, **_ROLL),
        _c("acrobot_gauss2", "order four", "acrobot", scheme="gauss2", cost="effort", **_ROLL),
        _c("elastic_gauss2", "order four", "elastic_pendulum", scheme="gauss2", cost="effort", **_ROLL),
        _c("rates_gauss2", "order four", "double_pendulum", scheme="gauss2", asks="rates", **_ROLL),
        _c("free_gauss2", "order four", "double_pendulum", scheme="gauss2", asks="free", **_ROLL),
        _c("via_gauss2", "order four", "double_pendulum", scheme="gauss2", asks="via_box", **_ROLL),
        _c("unicycle", "drive", "unicycle", scheme="heun", share=0.5, steps=(15, 20, 30), **_ROLL),
    )
}

# Those whose functions compile in a second or two.
QUICK = (
    "double_pendulum",
    "double_pendulum_midpoint",
    "double_pendulum_slow",
    "acrobot",
    "cart_pendulum",
    "elastic_pendulum",
    "rigid_pendulum",
    "double_pendulum_span",
    "double_pendulum_gate",
    "elastic_pendulum_plane",
    "elastic_pendulum_line",
    "double_pendulum_via",
    "double_pendulum_via_box",
    "double_pendulum_pose",
    "double_pendulum_rates",
    "double_pendulum_free",
    "double_pendulum_fast",
    "double_pendulum_times",
    "double_pendulum_stages",
    "elastic_pendulum_follow",
    "double_pendulum_follow",
    "crate",
    "double_pendulum_gauss2",
    "rates_gauss2",
    "free_gauss2",
)
