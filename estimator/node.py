"""Estimator process: vehicle state and proposed models in; estimate, tyre belief and model revision out.

`Estimator` is a deterministic function of the messages it is given: everything it publishes is timed by their
stamps, so replaying a session gives the same bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise

import numpy as np

from estimator.belief.delivery import wheel_slips
from estimator.belief.in_use import ModelInUse, Succession
from estimator.belief.revision import RevisedModel, RevisionPolicy, starting_revision
from estimator.belief.tyre_belief import Sample, TyreBelief
from estimator.model.extra_load import extra_load
from estimator.model.measurement import MeasurementKind, axle_forces
from estimator.model.parameters import Quantity
from estimator.model.single_track import AUXILIARY, BEFORE_STEP_S, DRIVE_BEFORE, SingleTrack
from estimator.state.localisation import Localisation
from hil_gateway.agreement import agreement
from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import Alert, Belief, Estimate, VehicleState
from hil_gateway.car.actuation import brake_balance
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S, Arrivals, SystemClock
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

PROPOSALS = 4
QUEUE_DEPTH = 50
"""half a second of vehicle states: a pause shorter than that loses no sample"""
HALF_WINDOW = 3
"""the yaw acceleration is the slope of the yaw rate over this many samples either side"""

BEFORE_STEP = round(BEFORE_STEP_S * 100)
"""samples between two values of `DRIVE_BEFORE`"""
BEFORE = {name: BEFORE_STEP * k for k, name in enumerate(DRIVE_BEFORE, start=1)}
"""how many samples ago they were"""

LATE_STEER, LATE_DRIVE = 6, 15
"""samples, 0.06 and 0.15 s, by which steering and drive may act later than a model without their delay says"""

_NEUTRAL = dict.fromkeys(AUXILIARY, 0.0)
_TRACK_POSITION = [AUXILIARY.index("track_position")]


class Estimator:
    """State filter, tyre belief and revision policy behind the bus."""

    def __init__(self, config: Config, bus: Bus, track: Track | None = None, *, background: bool = False) -> None:
        """`background`: models of other effects are built beside the running filter."""
        self._bus = bus
        track = track or load_track(config.track)
        self._agreement = agreement(config, track)
        self.localisation = Localisation(config.declared_car, track, config.placing)
        self._full_brake = config.powertrain.brake_pressure_max
        self._use(ModelInUse.of(config, starting_revision(config, config.estimator.model), track.length))
        self._succession = Succession(config, track.length, background=background)
        self._learns = config.estimator.learn
        self._proposals = bus.subscribe(topics.MODEL_PROPOSAL, depth=PROPOSALS)
        self._seq = self._belief_seq = self._alert_seq = 0
        self._revision_seq = 1
        self._belief_due_ns = self._revision_due_ns = 0
        # last: what arrives while the model is being built would be old, and its answers a burst
        self._states = bus.subscribe(topics.VEHICLE_STATE, depth=QUEUE_DEPTH)

    def _use(self, model: ModelInUse) -> None:
        """Work with a model from now on."""
        self.model, self._window = model, SampleWindow(model.revised, self._full_brake)

    @property
    def belief(self) -> TyreBelief:
        """What is believed of the model in use."""
        return self.model.belief

    @property
    def policy(self) -> RevisionPolicy:
        """What is published of it."""
        return self.model.policy

    @property
    def received(self) -> bool:
        """Whether a vehicle state has ever come."""
        return self._seq > 0

    def step(self, now_ns: int) -> bool:
        """Work through the vehicle states that have arrived, in order; whether any has."""
        for proposal in self._proposals.poll(now_ns):
            self._succession.offer(proposal, self.policy.current)
        states = self._states.poll(now_ns)
        for state in states:
            self._take(state)
        return bool(states)

    def _take(self, state: VehicleState) -> None:
        if (following := self._succession.take(state.stamp_ns)) is not None:
            self._use(following)
        delivered = self.model.delivery.now()
        estimate = self.localisation.step(state, self._seq, delivered, self._agreement)
        self._seq += 1
        self._bus.publish(topics.ESTIMATE, estimate)
        if (sample := self._window.push(state, estimate, self.localisation)) is not None:
            self.learn(sample, state.stamp_ns)
            self._compare(sample, wheel_slips(state, estimate.vx), state.steer_late)
        else:
            self.model.delivery.clear()
        if _is_due(self._belief_due_ns, topics.BELIEF.period_ns, state.stamp_ns):
            self._belief_due_ns = state.stamp_ns + topics.BELIEF.period_ns
            self._bus.publish(topics.BELIEF, belief_message(self.model, state.stamp_ns, self._belief_seq))
            self._belief_seq += 1
        if _is_due(self._revision_due_ns, topics.MODEL_REVISION.period_ns, state.stamp_ns):
            self._revision_due_ns = state.stamp_ns + topics.MODEL_REVISION.period_ns
            revision = self.policy.message(self.belief, state.stamp_ns, self._revision_seq)
            self._bus.publish(topics.MODEL_REVISION, revision)
            self._revision_seq += 1

    def learn(self, sample: Sample, stamp_ns: int) -> None:
        """Watch the model with the belief held so far, then let the sample teach where learning is on."""
        sample, tyres = self._believed(sample)
        for finding in self.model.monitor.push(sample, tyres, self.belief.covariance, stamp_ns):
            self._bus.publish(topics.ALERT, Alert(stamp_ns=stamp_ns, seq=self._alert_seq, **asdict(finding)))
            self._alert_seq += 1
        if self._learns:
            self.belief.update(in_kind(sample, self.belief.settings.kind, self.belief.model.vehicle))

    def _compare(self, sample: Sample, slips: tuple[float, float], steer_late: float) -> None:
        """What tyres and brakes deliver now; `slips` of the wheels as `wheel_slips` says."""
        sample, tyres = self._believed(sample)
        self.model.delivery.push(sample, tyres, slips, steer_late)

    def _believed(self, sample: Sample) -> tuple[Sample, Array]:
        """The sample with the effects, and the tyre parameters, that are now believed."""
        mean, tyres = self.belief.mean, self.belief.tyres
        return sample._replace(phi=mean[tyres:]) if self.belief.with_effects else sample, mean[:tyres]


def _is_due(due_ns: int, period_ns: int, stamp_ns: int) -> bool:
    """Whether it is time again; it is where the stamps have gone back too: one far ahead silences nothing for good."""
    return not due_ns - period_ns <= stamp_ns < due_ns


def in_kind(sample: Sample, kind: MeasurementKind, vehicle: Vehicle) -> Sample:
    """An `imu_yaw` sample as another measurement variant."""
    if kind == "tyre_force":
        ax, ay, yaw_acc = sample.z.tolist()
        return sample._replace(z=axle_forces(vehicle, ax, ay, yaw_acc, float(sample.signals[3])))
    return sample if kind == "imu_yaw" else sample._replace(z=sample.z[:2])


def late_drive(model: SingleTrack) -> int:
    """Samples by which the drive command may act later than the model says; one is the present one."""
    return LATE_DRIVE if model.place_of(Quantity.DRIVE_DELAY) is None else 1


class SampleWindow:
    """Turns a run of states and estimates into `imu_yaw` samples, `HALF_WINDOW` samples late."""

    def __init__(self, revised: RevisedModel, full_brake: float) -> None:
        """`full_brake`: pressure of full braking, Pa."""
        self._revised, self._full_brake = revised, full_brake
        self._rows: deque[tuple[int, VehicleState, Estimate, Array, Array]] = deque(maxlen=2 * HALF_WINDOW + 1)
        self._steer: deque[float] = deque(maxlen=HALF_WINDOW + LATE_STEER)
        self._drive: deque[float] = deque(maxlen=HALF_WINDOW + late_drive(revised.model))
        self._past: deque[float] = deque(maxlen=len(DRIVE_BEFORE) * BEFORE_STEP + 1)

    def push(self, state: VehicleState, estimate: Estimate, localisation: Localisation) -> Sample | None:
        """Sample at the middle of the window once that is full, evenly spaced and valid throughout."""
        if not (state.valid and estimate.valid):
            self._rows.clear()
            self._past.clear()
            return None
        self._past.append(estimate.drive)
        aux = _auxiliary(state, estimate, localisation.track_position, self._past, self._full_brake)
        self._rows.append((state.stamp_ns, state, estimate, aux, localisation.motion_covariance))
        self._steer.append(estimate.steer)
        self._drive.append(estimate.drive)
        if len(self._rows) < 2 * HALF_WINDOW + 1:
            return None
        yaw_acc = slope([r[0] for r in self._rows], [r[2].yaw_rate for r in self._rows])
        return None if yaw_acc is None else self._sample(yaw_acc)

    def _sample(self, yaw_acc: float) -> Sample:
        _, state, e, aux, covariance = self._rows[HALF_WINDOW]
        z = np.array([state.ax - e.bias_ax, state.ay - e.bias_ay, yaw_acc])
        phi = self._revised.phi_at(aux[_TRACK_POSITION])[:, 0] if self._revised.profiles else self._revised.constants
        acting = acting_variance(self._steer), acting_variance(self._drive)
        return Sample(np.array([e.vx, e.vy, e.yaw_rate, e.steer, e.drive]), covariance, z, aux, phi, acting)


def acting_variance(reported: Sequence[float]) -> float:
    """Of inputs that act as they were reported at an unknown moment of a window.

    It lies between the least and the most of them, and all samples of the window have the same error, not errors of
    their own: they count as one.
    """
    return len(reported) * (0.5 * (max(reported) - min(reported))) ** 2


def acting_variances(reported: Array, late: int) -> Array:
    """`acting_variance` of every sample that `SampleWindow` makes of an input (n,), `late` as `LATE_STEER`; (n,)."""
    whole = np.pad(reported, (late - 1, HALF_WINDOW), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(whole, HALF_WINDOW + late)
    return np.array([acting_variance(window) for window in windows.tolist()])


def slope(stamps_ns: Sequence[int], values: Sequence[float]) -> float | None:
    """Least-squares slope over evenly spaced samples, 1/s; None where a sample is missing or late."""
    n = len(stamps_ns)
    step_ns = (stamps_ns[-1] - stamps_ns[0]) / (n - 1)
    steps = [b - a for a, b in pairwise(stamps_ns)]
    if step_ns <= 0 or not (0.5 * step_ns < min(steps) and max(steps) < 1.5 * step_ns):
        return None
    half = (n - 1) // 2
    weighted = sum([w * v for w, v in zip(range(-half, half + 1), values, strict=True)])
    return weighted * NS_PER_S / (step_ns * (half * (half + 1) * (2 * half + 1) // 3))


def _auxiliary(
    state: VehicleState, estimate: Estimate, track_position: float, drives: Sequence[float], full_brake: float
) -> Array:
    """Values of `AUXILIARY` as the car reports them; what it does not report stays neutral. `drives` up to now."""
    first = len(drives) - 1
    reported = {
        **_NEUTRAL, **{name: drives[max(first - ago, 0)] - estimate.drive for name, ago in BEFORE.items()},
        "track_position": track_position, "t": state.stamp_ns / NS_PER_S, "yaw": estimate.yaw,
        "throttle": state.throttle, "brake": 0.5 * (state.brake_front + state.brake_rear) / full_brake,
        "brake_balance": brake_balance(state.brake_front, state.brake_rear),
        "gear": float(state.gear), "engine_speed": state.engine_speed,
        "ax": state.ax - estimate.bias_ax, "steer_rate": state.steer_rate, "extra_load": extra_load(state.az),
    }  # fmt: skip
    return np.array([*reported.values()])


def belief_message(model: ModelInUse, stamp_ns: int, seq: int) -> Belief:
    """The belief about the tyres as it goes on the bus; that about effects goes into the revision."""
    belief = model.belief
    n = belief.tyres
    return Belief(
        stamp_ns=stamp_ns,
        seq=seq,
        layout=belief.model.layout,
        names=belief.names[:n],
        mean=tuple(belief.mean[:n].tolist()),
        covariance=tuple(map(tuple, belief.covariance[:n, :n].tolist())),
        samples=belief.samples,
        log_det_information=belief.log_det_information,
        residual=model.monitor.residual(),
    )


def run(config: Config) -> None:
    """Run the process until SIGINT or SIGTERM."""
    from hil_gateway.bus.zenoh_bus import open_bus
    from hil_gateway.process.journal import Journal
    from hil_gateway.process.lifecycle import SilenceNotice, StopRequest
    from hil_gateway.process.scheduling import punctual

    stopped, clock = StopRequest(), SystemClock()
    bus = open_bus(config.zenoh, "estimator")
    estimator = Estimator(config, bus, background=True)
    punctual("estimator")
    arrivals = Arrivals(round(NS_PER_S / topics.VEHICLE_STATE.rate_hz))
    notice = SilenceNotice("vehicle state", config.zenoh.connect, clock.now_ns())
    try:
        with Journal():
            while not stopped():
                now_ns = clock.now_ns()
                arrived = estimator.step(now_ns)
                notice.step(now_ns, estimator.received)
                clock.sleep_until(arrivals.next_look_ns(now_ns, arrived))
    finally:
        bus.close()
