"""What the compiled stage functions are given besides state and control, by name."""

from __future__ import annotations

from collections.abc import Mapping

from estimator.model.single_track import SingleTrack
from hil_gateway.process.arrays import Expr


class Names(dict[str, slice]):
    """Named slices of a parameter vector."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        super().__init__()
        self.size = 0
        for name, size in sizes.items():
            self[name] = slice(self.size, self.size + size)
            self.size += size

    def split(self, vector: Expr) -> dict[str, Expr]:
        """Symbolic parts by name."""
        return {name: vector[s] for name, s in self.items()}


def stage_names(model: SingleTrack) -> Names:
    """Parameters of one stage.

    Knot s and cubics of the reference line in s - knot (power 0..3), offset of the middle of the track from the line at
    the knot and its slope, half the width left to the CoG (m), speed limit at the knot and its slope, weight q_v (0 at
    the last stage), share of q_I, multipliers of the two load rows, upper drive limit, changes of drive and steer that
    are on their way before the stage and shares of the interval in which they are still free, grade and bank (rad) of
    the track as far as no effect of the model stands for them, what the road adds to the axle loads (three rows of
    `Reference.stages`), effect parameters at the stage's place.
    """
    sizes = {"s": 1, "cubic_x": 4, "cubic_y": 4, "centre": 2, "half_width": 1, "speed": 2, "progress": 1, "learning": 1}
    own = {"multiplier": 2, "drive_max": 1, "sent": 2, "free": 2, "grade": 1, "bank": 1, "road_load": 3}
    return Names(sizes | own | {"phi": len(model.effect_table)})


def common_names(model: SingleTrack) -> Names:
    """Parameters shared by all stages.

    `sigma_f`, `sigma_r` are the choices of theta in Eq. (10) in columns: the one in force, then the sigma points,
    then the one with the least peak force;
    `brake_ratio` is that of `BrakeLaw.balance`, `brake_doubt` how many times braking forces count, front and rear,
    `information_theta` the belief's mean,
    `information_weight` W of Tr(W F), `trace_weight` the diagonal that makes it Tr(F) in prior-scaled parameters.
    """
    n = len(model.tyre_table)
    front, rear = model.load_rows
    return Names(
        {
            "theta": n,
            "lap": 1,
            "load_max": 2,
            "brake_ratio": 1,
            "brake_doubt": 2,
            "sigma_f": n * (2 * len(front) + 3),
            "sigma_r": n * (2 * len(rear) + 3),
            "information_theta": n,
            "information_weight": n * n,
            "trace_weight": n,
            "q_information": 1,
        }
    )
