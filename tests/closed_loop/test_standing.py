"""The car that stands: nothing starts by itself, the brakes hold it, and it drives off on a hill without rolling back.

Judged by the plant's own state.
"""

from __future__ import annotations

from itertools import pairwise

import pytest
from support.drives.sloped_track import place_of, sloped_file
from support.promise_figures import record_figure, volume

from hil_gateway.bus import topics
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.car.states import CtState
from hil_gateway.config import Config
from hil_gateway.gateway.core import Gateway
from hil_gateway.plant.controller.ladder import CarState, VehicleController
from planner.simulation.loop import Loop

STARTED = {CarState.PRE_CRANK, CarState.CRANKING, CarState.IDLE, CarState.DRIVING}
BELOW = (CtState.POWER_ON, CtState.INIT, CtState.ACTUATOR_TEST, CtState.CRANK_READY)
ABOVE = (CtState.CRANKING, CtState.RACE_READY, CtState.INIT_DRIVING, CtState.NOMINAL_RACE, CtState.EMERGENCY)
ROLLED_M = 0.1


class Idle:
    """A process that says nothing."""

    def __init__(self, *_: object) -> None:
        pass

    def step(self, now_ns: int) -> None:
        pass


class Scene:
    """The loop on a grade of 12 %, with a person who asks for what a test says and nothing else."""

    def __init__(self, grade: float = 0.12, driven: bool = False, **gateway: object) -> None:
        self.config = Config.model_validate(
            {"track": str(sloped_file()), "plant": {"start_s": place_of(grade)}, "gateway": gateway}
        )
        idle = None if driven else {"estimator": Idle, "planner": Idle}
        self.loop = Loop(self.config, arm=False, components=idle)
        self.start_s = self.loop.plant.car.road.s
        self.states: list[CarState] = []
        self.least_brake = float("inf")
        self.rolled = 0.0

    @property
    def ct_state(self) -> CtState:
        return self.loop.gateway.decision.race_control.ct_state

    @property
    def action(self) -> FailsafeAction:
        return self.loop.gateway.failsafe.action

    def run(self, seconds: float) -> None:
        for _ in range(round(100 * seconds)):
            self.step()

    def step(self) -> None:
        self.loop.step()
        plant = self.loop.plant
        self.states.append(plant.controller.state)
        self.least_brake = min(self.least_brake, plant.obeyed.brake_front)
        self.rolled = max(self.rolled, abs(plant.car.road.s - self.start_s))

    def forget(self) -> None:
        """From now on."""
        self.start_s, self.states, self.least_brake, self.rolled = self.loop.plant.car.road.s, [], float("inf"), 0.0

    def reach(self, ct_state: CtState) -> None:
        """As a person would."""
        for _ in range(600):
            if self.ct_state == ct_state:
                return
            if self.ct_state is CtState.CRANK_READY:
                self.loop.ask(OperatorAction.CRANK)
            if ct_state is CtState.EMERGENCY:
                self.loop.ask(OperatorAction.EMERGENCY)
            self.step()
        raise AssertionError(f"never at {ct_state}: {self.ct_state}, {self.loop.plant.controller.state}")

    def restart(self, victim: str, dead_s: float) -> None:
        """What ended starts again after `dead_s`."""
        if victim in ("car", "both"):
            self.loop.plant.controller = VehicleController()
            self.loop.plant._transmitter._controller = self.loop.plant.controller
            self.loop.plant._receiver.forget()
        if victim in ("gateway", "both"):
            old, idle = self.loop.gateway, Idle()
            self._put(idle)
            self.run(dead_s)
            old._link.receive()  # nobody has listened meanwhile
            self._put(Gateway(self.config, self.loop.bus, old._link, self.loop.plant.car.road.track))

    def _put(self, gateway: object) -> None:
        loop = self.loop
        loop._schedule = tuple((n, gateway if n == "gateway" else core, p) for n, core, p in loop._schedule)
        if isinstance(gateway, Gateway):
            loop.gateway = gateway


def entered(states: list[CarState]) -> set[CarState]:
    """States the car climbed into, beside that of the beginning."""
    return {after for before, after in pairwise(states) if after != before} & STARTED


@pytest.mark.slow
@pytest.mark.promise("G1")
@pytest.mark.parametrize("ct_state", [*BELOW, *ABOVE])
def test_nothing_starts_by_itself(ct_state):
    restarts = (("gateway", 0.0), ("both", 0.6), ("gateway", 1.4), ("car", 0.0))
    for victim, dead_s in restarts[: volume(2, 4)]:
        scene = Scene()
        scene.reach(ct_state)
        scene.forget()
        scene.restart(victim, dead_s)
        at_restart = len(scene.states)  # until then the car may end the cranking that a person had asked for
        scene.run(4.0)
        assert entered(scene.states[at_restart:]) == set(), (victim, dead_s, scene.states[-1])
        assert scene.ct_state in (CtState.CRANK_READY, CtState.EMERGENCY), (victim, dead_s)
        assert scene.rolled < ROLLED_M, (victim, dead_s, scene.rolled)
        assert scene.least_brake > 0.0, (victim, dead_s)
    record_figure(
        "G1", f"ct_state {int(ct_state)}, gateway, car and both restarted: no cranking, brakes on, not rolled"
    )


@pytest.mark.slow
@pytest.mark.promise("G1")
def test_a_request_to_crank_is_not_remembered():
    scene = Scene()
    said = scene.loop.bus.subscribe(topics.GATEWAY_STATUS, depth=1)
    scene.loop.ask(OperatorAction.CRANK)  # too early: the car has not answered yet
    scene.run(5.0)
    assert scene.ct_state is CtState.CRANK_READY
    assert "hil gateway crank" in said.poll(0)[-1].advice["car_not_driving"]
    scene.reach(CtState.NOMINAL_RACE)
    scene.loop.ask(OperatorAction.EMERGENCY)
    scene.run(1.0)
    scene.loop.ask(OperatorAction.CRANK)
    scene.run(1.0)
    scene.loop.ask(OperatorAction.DISARM)
    scene.forget()
    scene.run(6.0)
    assert scene.ct_state is CtState.CRANK_READY
    assert entered(scene.states) == set()
    record_figure("G1", "a request to crank that comes too early or in an emergency is dropped")


@pytest.mark.slow
@pytest.mark.promise("G2")
@pytest.mark.parametrize("grade", [0.12, pytest.param(-0.12, marks=pytest.mark.long)])
def test_a_hill_start_does_not_roll(grade):
    scene = Scene(grade, driven=True)
    scene.reach(CtState.NOMINAL_RACE)
    scene.run(10.0)
    assert scene.loop.gateway.decision.holding
    assert scene.rolled < ROLLED_M
    back, starts = [], volume(1, 2)
    for _ in range(starts):
        scene.loop.ask(OperatorAction.ARM)
        start_s = least_s = scene.loop.plant.car.road.s
        for _ in range(300):
            scene.step()
            least_s = min(least_s, scene.loop.plant.car.road.s)
        assert scene.action is FailsafeAction.DRIVE
        assert scene.loop.plant.car["vx"] > 2.0, "under way"
        back.append(start_s - least_s)
        scene.loop.ask(OperatorAction.STOP)
        scene.run(4.0)
        scene.forget()
        scene.loop.ask(OperatorAction.DISARM)
        scene.run(4.0)
        assert scene.loop.plant.controller.state is CarState.DRIVING, "the engine goes on"
        assert scene.rolled < ROLLED_M
    assert max(back) < ROLLED_M
    record_figure("G2", f"start on {100 * grade:.0f} %, {starts} times: rolled back {1e3 * max(back):.0f} mm")


@pytest.mark.slow
def test_switched_off_a_car_on_a_hill_rolls():
    scene = Scene(hold=False)
    scene.reach(CtState.NOMINAL_RACE)
    scene.run(2.0)
    assert scene.rolled > ROLLED_M


@pytest.mark.slow
@pytest.mark.parametrize("hold", [True, pytest.param(False, marks=pytest.mark.long)])
def test_one_disarm_is_enough_after_an_emergency_in_which_the_car_lost_its_power(hold):
    scene = Scene(0.0, driven=True, hold=hold)
    scene.reach(CtState.NOMINAL_RACE)
    scene.run(1.0)
    scene.loop.ask(OperatorAction.ARM)
    scene.run(2.0)
    assert scene.action is FailsafeAction.DRIVE
    scene.loop.ask(OperatorAction.EMERGENCY)
    scene.run(4.0)
    scene.restart("car", 0.0)
    scene.run(2.0)
    scene.loop.ask(OperatorAction.DISARM)
    scene.run(4.0)
    assert (scene.ct_state, scene.loop.plant.controller.state) == (CtState.CRANK_READY, CarState.CRANK_READY)
