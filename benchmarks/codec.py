"""Codec against cantools on the same frames in the same run: decode at least 3 times, strict encode 5 times as fast.

python -m benchmarks.codec [--json]
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import timeit
from collections.abc import Callable
from typing import Any

import cantools

from can_dbc.codec import Fault, load_codec
from can_dbc.folder import SHIPPED

REQUIRED = {"decode": 3.0, "encode": 5.0}
ROUNDS = 9


def best_times(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Best of several rounds of each, s; taken in turn, so that a busy neighbour counts for neither side."""
    rounds = [{name: timeit.timeit(call, number=1) for name, call in calls.items()} for _ in range(ROUNDS)]
    return {name: min(times[name] for times in rounds) for name in calls}


def measure(frames_per_message: int = 40) -> dict[str, float]:
    """Mean time per frame over every message with random legal values, us (cantools encodes strictly by default)."""
    codec = load_codec()
    peer = cantools.database.load_file(SHIPPED / "av24/av24.dbc")
    rng = random.Random(1)
    frames, si_values, dbc_values = [], [], []
    for message in codec.messages.values():
        for _ in range(frames_per_message):
            values = {}
            for signal in message.signals:
                low, high = signal.declared or (-1e30, 1e30)
                raw = rng.randint(*signal.raw_range)
                values[signal.name] = min(max(raw * signal.scale + signal.offset, low), high)
            frame_id, data = codec.encode_raw(message.name, values)
            frames.append((frame_id, data))
            dbc_values.append((message.name, codec.decode_raw(frame_id, data)))
            decoded = codec.decode(frame_id, data)
            assert not isinstance(decoded, Fault), decoded
            si_values.append((message.name, decoded))
    decode, encode = codec.decode, codec.encode
    peer_decode, peer_encode = peer.decode_message, peer.encode_message
    times = best_times(
        {
            "decode_us": lambda: [decode(i, d) for i, d in frames],
            "cantools_decode_us": lambda: [peer_decode(i, d) for i, d in frames],
            "encode_us": lambda: [encode(m, v) for m, v in si_values],
            "cantools_encode_us": lambda: [peer_encode(m, v) for m, v in dbc_values],
        }
    )
    return {name: 1e6 * seconds / len(frames) for name, seconds in times.items()}


def main() -> int:
    """Print times and ratios; exit code 1 when a ratio falls short."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    result: dict[str, Any] = measure()
    for name in REQUIRED:
        result[f"{name}_ratio"] = result[f"cantools_{name}_us"] / result[f"{name}_us"]
    result["ok"] = all(result[f"{name}_ratio"] >= required for name, required in REQUIRED.items())
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, required in REQUIRED.items():
            ours, theirs, ratio = result[f"{name}_us"], result[f"cantools_{name}_us"], result[f"{name}_ratio"]
            print(f"{name}: {ours:.2f} us, cantools {theirs:.2f} us: {ratio:.1f} times as fast (required {required:g})")
    return 0 if result["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
