"""The gateway's receive path under load: a full 1 Mbit/s bus (8,000 frames/s), and four of them at once.

    python -m benchmarks.gateway [--seconds S] [--json]

A separate process sends the messages of the car, paced; the gateway side wakes every 10 ms, receives from each bus,
decodes and keeps the vehicle state, as the gateway process does. In the same run python-can with cantools does
the same receiving and decoding on the same traffic. Required: no frame lost, and at most half the CPU time a frame.
The bus is vcan where the kernel has it, else UDP multicast on loopback, and the result says which.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import socket
import sys
import time
from collections.abc import Callable
from multiprocessing.synchronize import Event
from typing import Any

from can_dbc.codec import Fault, load_codec
from can_dbc.folder import SHIPPED
from hil_gateway.can_link import CanLink, Frame, open_link
from hil_gateway.can_link.opening import interface_exists
from hil_gateway.car.actuation import Actuation
from hil_gateway.config import CanConfig, Config
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder

FULL_BUS_HZ = 8_000
PERIOD_S = 0.01
BURST_S = 0.001
REQUIRED_RATIO = 2.0
BASE_PORT = 46_000


def buses(count: int) -> list[CanConfig]:
    """Configurations of separate buses: vcan0, vcan1, ... if they all exist, else loopback ports."""
    channels = [f"vcan{number}" for number in range(count)]
    if all(map(interface_exists, channels)):
        return [CanConfig(interface="socketcan", channel=channel) for channel in channels]
    ports = (BASE_PORT + os.getpid() % 1000 * 8 + number for number in range(count))
    return [CanConfig(interface="udp_multicast", multicast_port=port) for port in ports]


def car_traffic(frames: int) -> list[tuple[int, bytes]]:
    """Frames of the car in turn, legal random values, counters running."""
    codec, rng = load_codec(), random.Random(7)
    messages = [message for message in codec.messages.values() if message.direction == "car"]
    traffic = []
    for index in range(frames):
        message = messages[index % len(messages)]
        values = {}
        for signal in message.signals:
            low, high = signal.limits or signal.declared or (0.0, 100.0)
            values[signal.name] = rng.uniform(low, high)
        if message.counter:
            values[message.counter.signal] = index // len(messages) % message.counter.modulus
        traffic.append(codec.encode_raw(message.name, values))
    return traffic


def send(configs: list[CanConfig], rate_hz: int, seconds: float, ready: Event, started: Event) -> None:
    """Send the traffic to every bus in bursts of a millisecond (a burst late is caught up)."""
    links = [open_link(config) for config in configs]
    traffic = car_traffic(2_000)
    ready.set()
    started.wait()
    begin, total, done = time.monotonic(), int(rate_hz * seconds), 0
    while done < total:
        due = min(total, int((time.monotonic() - begin) * rate_hz) + 1)
        for index in range(done, due):
            for link in links:
                link.send(*traffic[index % len(traffic)])
        done = due
        time.sleep(BURST_S)


def receive(poll: Callable[[], int], expected: int, seconds: float) -> tuple[int, float, float]:
    """(frames, CPU s, wall s) of polling every period until all have come or nothing comes any more."""
    received, cpu = 0, time.process_time()
    begin = due = last = time.monotonic()
    while received < expected and time.monotonic() - last < 0.5 + seconds * (received == 0):
        got = poll()
        received += got
        last = time.monotonic() if got else last
        due += PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))
    return received, time.process_time() - cpu, last - begin


def run(configs: list[CanConfig], seconds: float, poll: Callable[[], int]) -> dict[str, Any]:
    """One stretch of traffic through one receiver."""
    context = multiprocessing.get_context("spawn")
    ready, started = context.Event(), context.Event()
    sender = context.Process(target=send, args=(configs, FULL_BUS_HZ, seconds, ready, started), daemon=True)
    sender.start()
    ready.wait()
    poll()
    started.set()
    expected = int(FULL_BUS_HZ * seconds) * len(configs)
    received, cpu, wall = receive(poll, expected, seconds)
    sender.join()
    return {
        "bus": configs[0].interface,
        "frames": received,
        "lost": expected - received,
        "frames_per_s": received / wall,
        "cpu_us_per_frame": 1e6 * cpu / max(received, 1),
        "cpu_share": cpu / wall,
    }


class GatewayPath:
    """Receive, decode, keep the state: what the gateway does with its frames."""

    def __init__(self, configs: list[CanConfig]) -> None:
        config = Config()
        actuation = Actuation(config.vehicle, config.powertrain)
        self.links = [open_link(can) for can in configs]
        self.builders = [VehicleStateBuilder(config, actuation) for _ in configs]
        self.latency_ms: list[float] = []

    def __call__(self) -> int:
        received = 0
        for link, builder in zip(self.links, self.builders, strict=True):
            frames = link.receive()
            now_ns = time.monotonic_ns()
            builder.take(frames, now_ns)
            builder.build(now_ns, 0, 0, 0)
            if frames:
                done_ns = time.monotonic_ns()
                self.latency_ms += [(done_ns - frame.stamp_ns) / 1e6 for frame in frames[:: max(len(frames) // 8, 1)]]
            received += len(frames)
        return received

    def close(self) -> None:
        for link in self.links:
            link.close()


class DecodePath:
    """Receive and decode only, for the comparison with the peer."""

    def __init__(self, configs: list[CanConfig]) -> None:
        self.links: list[CanLink] = [open_link(can) for can in configs]
        self._decode = load_codec().decode

    def __call__(self) -> int:
        frames: list[Frame] = [frame for link in self.links for frame in link.receive()]
        bad = sum(isinstance(self._decode(frame.id, frame.data), Fault) for frame in frames)
        assert bad == 0
        return len(frames)

    def close(self) -> None:
        for link in self.links:
            link.close()


class PeerPath:
    """python-can and cantools doing the same."""

    def __init__(self, configs: list[CanConfig]) -> None:
        import cantools

        self.buses = [peer_bus(config) for config in configs]
        self._decode = cantools.database.load_file(SHIPPED / "av24/av24.dbc").decode_message

    def __call__(self) -> int:
        received = 0
        for bus in self.buses:
            while (message := bus.recv(0)) is not None:
                self._decode(message.arbitration_id, message.data, decode_choices=False)
                received += 1
        return received

    def close(self) -> None:
        for bus in self.buses:
            bus.shutdown()


def peer_bus(config: CanConfig) -> Any:
    """python-can's bus on the same interface, given the same receive buffer; its UDP group joined on loopback."""
    import can

    from hil_gateway.can_link.base import RECEIVE_BUFFER_BYTES, SO_RCVBUFFORCE

    if config.interface == "socketcan":
        bus = can.Bus(interface="socketcan", channel=config.channel)
    else:
        bus = can.Bus(interface="udp_multicast", channel=config.multicast_group, port=config.multicast_port)
    with socket.socket(fileno=os.dup(bus.fileno())) as handle:
        try:
            handle.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
        except OSError:
            handle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        if config.interface == "udp_multicast":
            group = socket.inet_aton(config.multicast_group) + socket.inet_aton("127.0.0.1")
            handle.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
    return bus


def measure(seconds: float) -> dict[str, Any]:
    """Both loads through the gateway's path, then ours and the peer's decoding at the same load."""
    result: dict[str, Any] = {}
    for count in (1, 4):
        path = GatewayPath(configs := buses(count))
        result[f"gateway_{count}"] = run(configs, seconds, path)
        latency = sorted(path.latency_ms) or [float("nan")]
        result[f"gateway_{count}"] |= {
            f"latency_ms_p{share}": latency[int(share / 100 * (len(latency) - 1))] for share in (50, 99)
        }
        path.close()
    for name, kind in (("ours", DecodePath), ("peer", PeerPath)):
        receiver = kind(configs := buses(1))
        result[name] = run(configs, seconds, receiver)
        receiver.close()
    result["ratio"] = result["peer"]["cpu_us_per_frame"] / result["ours"]["cpu_us_per_frame"]
    result["lost"] = result["gateway_1"]["lost"] + result["gateway_4"]["lost"]
    result["ok"] = result["lost"] == 0 and result["ratio"] >= REQUIRED_RATIO
    return result


def main() -> int:
    """Print the figures; exit code 1 when a frame was lost or the ratio falls short."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=4.0, help="length of each of the four stretches")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    result = measure(arguments.seconds)
    if arguments.json:
        print(json.dumps(result))
        return 0 if result["ok"] else 1
    for count in (1, 4):
        row = result[f"gateway_{count}"]
        print(
            f"{count} full bus{'es' * (count > 1)} over {row['bus']}: "
            f"{row['frames_per_s']:.0f} frames/s, {row['lost']} lost, "
            f"{row['cpu_us_per_frame']:.1f} us CPU a frame, {row['cpu_share']:.0%} of a core, "
            f"arrival to state {row['latency_ms_p50']:.1f} ms median, {row['latency_ms_p99']:.1f} ms p99 (10 ms period)"
        )
    ours, peer = result["ours"]["cpu_us_per_frame"], result["peer"]["cpu_us_per_frame"]
    print(
        f"receive and decode: {ours:.1f} us CPU a frame, python-can + cantools {peer:.1f} us: "
        f"{result['ratio']:.1f} times less (required {REQUIRED_RATIO:g})"
    )
    return 0 if result["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
