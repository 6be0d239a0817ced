"""The base station of the simulated car: flags, speed and heartbeat, as a person at its desk asks for them."""

from __future__ import annotations

from dataclasses import dataclass

from hil_gateway.bus.interface import Bus
from hil_gateway.bus.topics import RACE_CONTROL, RACE_CONTROL_REQUEST
from hil_gateway.bus.track_day.race_control import RaceControlShown
from hil_gateway.car.states import TrackFlag, VehicleFlag


@dataclass
class SimulatedRaceControl:
    """What the base station says; tests and people change it."""

    track_flag: int = TrackFlag.GREEN
    vehicle_flag: int = VehicleFlag.NONE
    target_speed: float = 0.0
    """m/s under yellow; 0: none named"""
    beating: bool = True
    heartbeat: int = 0


class Desk:
    """Requests from the bus to the base station; says what it shows."""

    def __init__(self, bus: Bus, shown: SimulatedRaceControl) -> None:
        self._bus, self._shown = bus, shown
        self._requests = bus.subscribe(RACE_CONTROL_REQUEST, depth=16)
        self._due_ns, self._seq = 0, 0

    def step(self, now_ns: int) -> None:
        """Take what was asked for; publish at once then, else five times a second."""
        requests = self._requests.poll(now_ns)
        for request in requests:
            for name in ("track_flag", "vehicle_flag", "target_speed", "beating"):
                if (value := getattr(request, name)) is not None:
                    setattr(self._shown, name, value)
        if requests or now_ns >= self._due_ns:
            self._due_ns, self._seq = now_ns + RACE_CONTROL.period_ns, self._seq + 1
            self._bus.publish(RACE_CONTROL, self._message(now_ns))

    def _message(self, now_ns: int) -> RaceControlShown:
        shown = self._shown
        return RaceControlShown(
            stamp_ns=now_ns, seq=self._seq, track_flag=TrackFlag(shown.track_flag),
            vehicle_flag=VehicleFlag(shown.vehicle_flag), target_speed=shown.target_speed, beating=shown.beating,
        )  # fmt: skip
