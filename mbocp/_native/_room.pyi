from mbocp._arrays import Array

class Room:
    def __init__(
        self,
        *,
        nq: int,
        joints: Array,
        places: Array,
        spheres: Array,
        shapes: Array,
        planes: Array,
        pairs: Array,
    ) -> None: ...
    def values(self, qs: Array, near: float, pairs: Array) -> Array: ...
    def groups(self, qs: Array, near: float) -> Array: ...
    def nearest(self, qs: Array, near: float) -> Array: ...
    def joints(self, qs: Array) -> Array: ...
    def least(self, qs: Array, most: float) -> Array: ...
    def way(
        self,
        *,
        ends: Array,
        ranges: Array,
        groups: Array,
        reserve: float,
        step: float,
        resolution: float,
        most: int,
        cuts: int,
        seed: int,
    ) -> Array: ...
