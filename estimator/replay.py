"""Replays a session through the estimator: recorded and replayed outputs must be the same bytes.

The estimator is a function of the vehicle states and proposed models it is given, in their order, and of its
configuration; all are in the recording.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from estimator.estimate_session import DEPTH
from estimator.node import Estimator
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import VehicleState
from hil_gateway.bus.proposal import ModelProposal
from hil_gateway.bus.topics import BELIEF, ESTIMATE, MODEL_PROPOSAL, MODEL_REVISION, VEHICLE_STATE
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import unpack_message
from hil_gateway.session.files.reader import Item, SessionReader

OUTPUTS = (ESTIMATE, BELIEF, MODEL_REVISION)


@dataclass(frozen=True)
class Comparison:
    """Outputs of a topic: how many were recorded, and how many of these the replay reproduced byte for byte."""

    recorded: int
    identical: int


def replay_estimator(path: Path, config: Config) -> dict[str, list[bytes]]:
    """Everything the estimator publishes when given the vehicle states of a session, by topic, in order.

    It begins with the state its first recorded estimate answers: what came before never reached it.
    """
    states, proposals = _inputs(SessionReader(path, frozenset({VEHICLE_STATE.key, ESTIMATE.key, MODEL_PROPOSAL.key})))
    bus = LocalBus()
    estimator = Estimator(config, bus)
    outputs = {topic: bus.subscribe(topic, depth=DEPTH) for topic in OUTPUTS}
    published: dict[str, list[bytes]] = {topic.key: [] for topic in OUTPUTS}
    for state in states:
        # a proposal takes effect by the stamp it names, however long it was under way
        while proposals and proposals[0].use_from_ns <= state.stamp_ns:
            bus.publish(MODEL_PROPOSAL, proposals.popleft())
        bus.publish(VEHICLE_STATE, state)
        estimator.step(state.stamp_ns)
        for topic, subscription in outputs.items():
            published[topic.key] += [m.model_dump_json().encode() for m in subscription.poll(state.stamp_ns)]
    return published


def _inputs(reader: SessionReader) -> tuple[list[VehicleState], deque[ModelProposal]]:
    states, proposals, first_ns = [], deque[ModelProposal](), None
    for item in reader.items():
        if item.topic == VEHICLE_STATE.key:
            states.append(unpack_message(VEHICLE_STATE, item.data))
        elif item.topic == MODEL_PROPOSAL.key:
            proposals.append(unpack_message(MODEL_PROPOSAL, item.data))
        elif first_ns is None:
            first_ns = unpack_message(ESTIMATE, item.data).state_stamp_ns
    if first_ns is None:
        raise InputError(f"{reader.path}: holds no {ESTIMATE}: there is nothing to compare with")
    return [state for state in states if state.stamp_ns >= first_ns], proposals


def compare(path: Path, replayed: Mapping[str, list[bytes]]) -> dict[str, Comparison]:
    """How much of the recorded outputs the replay reproduces."""
    recorded: dict[str, list[Item]] = {key: [] for key in replayed}
    for item in SessionReader(path, frozenset(replayed)).items():
        recorded[item.topic].append(item)
    return {
        key: Comparison(len(items), sum(item.data in known for item in items))
        for key, items in recorded.items()
        for known in (set(replayed[key]),)
    }
