"""Adds what the estimator makes of the vehicle states of a session: estimates, belief, model revisions, alerts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from estimator.node import Estimator
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import ALERT, BELIEF, ESTIMATE, MODEL_PROPOSAL, MODEL_REVISION, VEHICLE_STATE, Topic
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import named, unpack_message
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import Item, SessionReader
from hil_gateway.session.files.writer import FLUSH_EVERY, SessionFile

OUTPUTS: tuple[Topic[Any], ...] = (ESTIMATE, BELIEF, MODEL_REVISION, ALERT)
DEPTH = 64
"""outputs of one step that are kept"""


def estimate_session(source: Path, target: Path, config: Config) -> dict[str, int]:
    """Copy `source` to `target` with the estimator's outputs in the place of any it holds; counts by topic.

    Also counted: `valid`, the estimates the filter itself calls valid.

    Raises:
        InputError: no recording, no vehicle states in it, `target` cannot be written.
    """
    reader, count = SessionReader(source), Counter[str]()
    with output_file(target, source) as path, SessionFile(path, {}, attached=config.car.files()) as file, named(source):
        for written, item in enumerate(_with_outputs(reader, config, count), start=1):
            file.add(item.topic, item.data, item.log_ns, item.publish_ns, item.sequence)
            if written % FLUSH_EVERY == 0:
                file.flush()
        for name, values in reader.metadata.items():
            file.add_metadata(name, values)
        if not count[ESTIMATE.key]:
            reason = f"holds no {VEHICLE_STATE}; `hil session import --estimate` makes them of frames"
            raise InputError(f"{source}: {reason}")
    return dict(count)


def _with_outputs(reader: SessionReader, config: Config, count: Counter[str]) -> Iterator[Item]:
    bus = LocalBus()
    estimator = Estimator(config, bus)
    queues = [(topic, bus.subscribe(topic, depth=DEPTH)) for topic in OUTPUTS]
    replaced = {topic.key for topic in OUTPUTS}
    for item in reader.items():
        if item.topic in replaced:
            continue
        yield item
        if item.topic == MODEL_PROPOSAL.key:
            bus.publish(MODEL_PROPOSAL, unpack_message(MODEL_PROPOSAL, item.data))
        if item.topic != VEHICLE_STATE.key:
            continue
        state = unpack_message(VEHICLE_STATE, item.data)
        offset_ns = item.publish_ns - state.stamp_ns
        bus.publish(VEHICLE_STATE, state)
        estimator.step(state.stamp_ns)
        for topic, queue in queues:
            for message in queue.poll(state.stamp_ns):
                count[topic.key] += 1
                count["valid"] += topic is ESTIMATE and message.valid
                stamp_ns = message.stamp_ns + offset_ns
                yield Item(topic.key, item.log_ns, stamp_ns, message.seq, message.model_dump_json().encode())
