"""What the air and hard driving add to a fast car, estimated along with the tyres of an identification.

At the speeds of ovals the air bears half of the weight, and half of the driven axle's force goes into drag. At the
limit of grip that force, the load it moves and the differential then take more of an axle's lateral force than the
errors of a sensor; left out, they are taken for tyres that fall off beyond their peak.
"""

from __future__ import annotations

from estimator.model.effect import Effect
from estimator.model.effects import catalogue, effect_with
from estimator.model.parameters import Parameter, Quantity
from estimator.model.single_track import Terms
from estimator.offline.predict.nuisance import along
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Expr

PRESSED = 0.25
"""Share of an axle's static load: as much more cornering stiffness as a log leaves unknown"""


def presses(fast: float, vehicle: Vehicle) -> bool:
    """Whether the air of a race car presses on an axle at `fast` m/s with more than `PRESSED` of its static load."""
    typical = effect_with(Quantity.DOWNFORCE).parameters[0].prior_std
    return bool(typical * fast**2 > PRESSED * min(vehicle.static_load_front, vehicle.static_load_rear))


def loads() -> tuple[Effect, ...]:
    """Axle loads by the air and by ax."""
    return _fitted_with_tyres("loads")


def forces() -> tuple[Effect, ...]:
    """The force of the driven axle, and what that does across the car: to be fitted from where the loads are known.

    Without them, both grow on the wrong side of the peak of a tyre that is not known yet. Of the differential the form
    that goes with the yaw rate alone: lever and compliance of the other are not told apart on an oval.
    """
    return (drive_zero(), *_fitted_with_tyres("forces"))


def _fitted_with_tyres(part: str) -> tuple[Effect, ...]:
    return tuple(along(e.as_logged or e) for e in catalogue().values() if e.fitted_with_tyres == part)


def _from_zero(terms: Terms, zero: Expr) -> None:
    terms.drive = terms.drive - zero


def drive_zero() -> Effect:
    """Drive at which the driven axle neither pushes nor drags.

    Slip of wheels whose radius nobody measured is nothing at its median, where it pushes against the drag.
    """
    return Effect(
        name="drive_zero",
        lacks="the reported drive is zero where the driven axle rolls freely",
        equation="d = d_reported - d_0",
        source="definition",
        parameters=(Parameter("drive_zero.zero", "1", 0.0, 0.01, -0.05, 0.05, "reported where the axle rolls freely"),),
        channels=(),
        hooks={"INPUT": _from_zero},
    )
