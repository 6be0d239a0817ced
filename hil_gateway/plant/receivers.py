"""Receivers of the simulated car on its network: NovAtel OEM7 logs, with what really happens to them.

A GNSS position with RTK and its velocity 20 times a second, the inertial solution and the sums of its unit 100 times.
Their errors are drawn from numbers of their own, not from what a car folder declares. Everything arrives late. Without
corrections the position is that of a single receiver, metres off, and says so; when they are back it is a float one for
some seconds. The inertial solution knows where the car points once it has been faster than a person walks.
"""

from __future__ import annotations

import math
import socket
from collections import deque
from collections.abc import Iterable, Mapping
from enum import IntEnum

import numpy as np

from hil_gateway.car.car import Car as Platform
from hil_gateway.config import Config
from hil_gateway.plant.car import Car
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.receiver.oem7 import GPS_EPOCH_UNIX_S, WEEK_S, ReceiverLog, encode
from hil_gateway.track.geodesy import LocalMap

PERIOD_NS = NS_PER_S // 100
"""of the inertial solution"""
GNSS_EVERY = 5
"""periods: 20 Hz"""
LEAP_S = 18
LATE_S, JITTER_S = 0.08, 0.003
"""from the time that a log is of to its arrival: mean, and deviation (half-normal) on top of it"""
RTK_M, RTK_WANDER_M, RTK_WANDER_S = 0.008, 0.012, 30.0
"""position with fixed ambiguities: white noise, multipath that wanders, its time constant; data sheet 0.01 m + 1 ppm"""
SINGLE_M, SINGLE_WANDER_M, SINGLE_WANDER_S = 0.3, 1.2, 60.0
"""without corrections; data sheet 1.2 m"""
FLOAT_M = 0.25
VELOCITY_MPS = 0.03
"""of the GNSS; data sheet 0.03 m/s. It is the mean since the position before, and late by half of that"""
INS_VELOCITY_MPS, INS_VELOCITY_S, AZIMUTH_DEG = (0.015, 0.02, 0.03), 10.0, 0.08
"""of the inertial solution with fixed and float ambiguities and without corrections, how long its error lasts, s; data
sheets of tactical units"""
AZIMUTH_NOISE_DEG, AZIMUTH_S = 0.01, 60.0
"""its azimuth hardly scatters from log to log: its error wanders, with this time constant"""
MOUNTED_DEG = 0.4
"""deviation of how its axes are turned against the car's, after a calibration"""
RATE_RADPS, FORCE_MPS2 = 0.001, 0.03
"""of its unit, of a mean over 0.01 s"""
REFIX_S = 4.0
"""of float ambiguities after corrections are back"""
WALKING = 1.4
"""m/s at which the inertial solution finds where the car points"""
DATUM, UNDULATION_M = 61, -30.0
"""WGS 84; geoid above the ellipsoid"""
FINESTEERING = 180
SEED = 7
"""beside that of all sensor noise: receivers have their own"""
QUEUE = 1 << 20
"""bytes that a reader may be behind before it is disconnected, as the receiver's own port does"""


class PositionType(IntEnum):
    """OEM7 manual, BESTPOS and INSPVAX."""

    SINGLE = 16
    FLOAT = 34
    INT = 50
    INS_SINGLE = 53
    INS_FLOAT = 55
    INS_INT = 56


class InsStatus(IntEnum):
    """OEM7 manual, INSPVAX."""

    ALIGNING = 1
    GOOD = 3


GNSS_TYPES = (PositionType.INT, PositionType.FLOAT, PositionType.SINGLE)
INS_TYPES = (PositionType.INS_INT, PositionType.INS_FLOAT, PositionType.INS_SINGLE)
"""with fixed and float ambiguities, and without corrections"""


class Wander:
    """Two first-order Gauss-Markov processes: of a place in east and north, m."""

    def __init__(self, draw: np.random.Generator, std: float, time_s: float) -> None:
        self._draw, self._std, self._time_s = draw, std, time_s
        self._now = std * draw.standard_normal(2)

    def step(self, dt: float) -> tuple[float, float]:
        """After `dt` s."""
        kept = math.exp(-dt / self._time_s)
        self._now = kept * self._now + self._std * math.sqrt(1.0 - kept * kept) * self._draw.standard_normal(2)
        east, north = self._now.tolist()
        return east, north


class SimulatedReceiver:
    """One of them; `sample` once in `PERIOD_NS`, `due` what has arrived by then."""

    def __init__(self, car: Car, at: tuple[float, float], local_map: LocalMap, seed: tuple[int, ...]) -> None:
        """`at`: place of its antenna from the centre of gravity, ahead and to the left, m."""
        self._car, self._at, self._map = car, at, local_map
        self._draw = np.random.default_rng(seed)
        self._rtk = Wander(self._draw, RTK_WANDER_M, RTK_WANDER_S)
        self._single = Wander(self._draw, SINGLE_WANDER_M, SINGLE_WANDER_S)
        self._azimuth, self._mounted = Wander(self._draw, AZIMUTH_DEG, AZIMUTH_S), MOUNTED_DEG * self._draw.normal()
        self._gains = Wander(self._draw, 1.0, INS_VELOCITY_S)
        self._ticks, self._aligned = 0, False
        self._corrected_s = REFIX_S
        """since corrections came back"""
        self._before: tuple[float, float] | None = None
        self._queue: deque[tuple[int, bytes]] = deque()

    def sample(self, now_ns: int, unix_offset_ns: int) -> None:
        """Logs of this instant, on their way."""
        gps_ms = (now_ns + unix_offset_ns) // 1_000_000 + (LEAP_S - GPS_EPOCH_UNIX_S) * 1000
        self._corrected_s = 0.0 if self._car.uncorrected else self._corrected_s + PERIOD_NS / NS_PER_S
        self._aligned = self._aligned or self._speed > WALKING
        logs = [self._inertial(), self._sums()]
        if self._ticks % GNSS_EVERY == 0:
            logs += self._satellite()
        self._ticks += 1
        week, ms = divmod(gps_ms, WEEK_S * 1000)
        data = b"".join(encode(ReceiverLog(name, week, ms, FINESTEERING, values)) for name, values in logs)
        late_s = LATE_S + JITTER_S * abs(self._draw.standard_normal())
        due_ns = now_ns + round(late_s * NS_PER_S)
        self._queue.append((max(due_ns, self._queue[-1][0] if self._queue else 0), data))

    def due(self, now_ns: int) -> bytes:
        """What has arrived."""
        found = []
        while self._queue and self._queue[0][0] <= now_ns:
            found.append(self._queue.popleft()[1])
        return b"".join(found)

    @property
    def _speed(self) -> float:
        return math.hypot(self._car["vx"], self._car["vy"])

    @property
    def _worth(self) -> int:
        """0 fixed, 1 float, 2 without corrections."""
        return 2 if self._car.uncorrected else int(self._corrected_s < REFIX_S)

    def _point(self) -> tuple[float, float, float, float]:
        """Place (m) and velocity (m/s) of the antenna, in the map."""
        car, (ahead, left) = self._car, self._at
        c, s, rate = math.cos(car["yaw"]), math.sin(car["yaw"]), car["yaw_rate"]
        vx, vy = car["vx"] - rate * left, car["vy"] + rate * ahead
        x, y = car["x"] + c * ahead - s * left, car["y"] + s * ahead + c * left
        return x, y, c * vx - s * vy, s * vx + c * vy

    def _satellite(self) -> list[tuple[str, Mapping[str, float]]]:
        x, y, *_ = self._point()
        worth, dt = self._worth, GNSS_EVERY * PERIOD_NS / NS_PER_S
        rtk, single = self._rtk.step(dt), self._single.step(dt)
        wander = single if worth == 2 else rtk
        noise = (RTK_M, FLOAT_M, SINGLE_M)[worth] * self._draw.standard_normal(2)
        latitude, longitude = self._map.to_geodetic(x + wander[0] + noise[0], y + wander[1] + noise[1])
        std = (math.hypot(RTK_M, RTK_WANDER_M), FLOAT_M, math.hypot(SINGLE_M, SINGLE_WANDER_M))[worth]
        position = {
            "position_type": GNSS_TYPES[worth], "latitude": latitude, "longitude": longitude,
            "height_msl": -UNDULATION_M, "undulation": UNDULATION_M, "datum": DATUM, "std_north": std, "std_east": std,
            "std_up": 2.0 * std, "differential_age_s": 0.0 if worth == 2 else 1.0, "satellites": 24,
            "satellites_used": 20,
        }  # fmt: skip
        before, self._before = self._before or (x, y), (x, y)
        east, north = ((now - then) / dt + VELOCITY_MPS * self._draw.standard_normal() for now, then in
                       ((x, before[0]), (y, before[1])))  # fmt: skip
        velocity = {
            "velocity_type": GNSS_TYPES[worth], "speed": math.hypot(east, north),
            "track": math.degrees(math.atan2(east, north)) % 360.0,
        }  # fmt: skip
        return [("BESTPOS", position), ("BESTVEL", velocity)]

    def _inertial(self) -> tuple[str, Mapping[str, float]]:
        x, y, east, north = self._point()
        worth, dt = self._worth, PERIOD_NS / NS_PER_S
        wander = self._single.step(dt) if worth == 2 else self._rtk.step(dt)
        latitude, longitude = self._map.to_geodetic(x + wander[0], y + wander[1])
        std, std_speed = (0.02, FLOAT_M, SINGLE_WANDER_M)[worth], INS_VELOCITY_MPS[worth]
        noise = std_speed * np.array(self._gains.step(dt))
        off = self._mounted + self._azimuth.step(dt)[0] + AZIMUTH_NOISE_DEG * self._draw.standard_normal()
        azimuth = 90.0 - math.degrees(self._car["yaw"]) + off
        return "INSPVAX", {
            "ins_status": InsStatus.GOOD if self._aligned else InsStatus.ALIGNING, "position_type": INS_TYPES[worth],
            "latitude": latitude, "longitude": longitude, "height_msl": -UNDULATION_M, "undulation": UNDULATION_M,
            "east": east + noise[0], "north": north + noise[1], "azimuth": azimuth % 360.0, "std_north": std,
            "std_east": std, "std_up": 2.0 * std, "std_speed_north": std_speed,
            "std_speed_east": std_speed, "std_speed_up": std_speed, "std_roll": AZIMUTH_DEG,
            "std_pitch": AZIMUTH_DEG, "std_azimuth": AZIMUTH_DEG,
        }  # fmt: skip

    def _sums(self) -> tuple[str, Mapping[str, float]]:
        """Of the inertial unit over the period: x to the right, y ahead, z up."""
        car, dt, noise = self._car, PERIOD_NS / NS_PER_S, self._draw.standard_normal(4).tolist()
        return "CORRIMUS", {
            "samples": 2, "yaw": dt * (car["yaw_rate"] + RATE_RADPS * noise[0]),
            "lateral": -dt * (car.output("ay") + FORCE_MPS2 * noise[1]),
            "longitudinal": dt * (car.output("ax") + FORCE_MPS2 * noise[2]),
            "vertical": dt * (car.output("az") + FORCE_MPS2 * noise[3]),
        }  # fmt: skip


class SimulatedReceivers:
    """Those that the configuration reads, where their car folder declares them."""

    def __init__(self, config: Config, car: Car) -> None:
        names, local_map = config.receivers if config.plant.receivers else (), LocalMap(config.origin)
        self._each = {
            name: SimulatedReceiver(car, _antenna(config.car, name), local_map, (config.plant.seed, SEED, index))
            for index, name in enumerate(names)
        }
        self._next_ns = 0
        self.unix_offset_ns = 0
        """Unix time less that of the plant: what GPS makes its time of"""

    def step(self, now_ns: int) -> None:
        """Once a step of the car."""
        if self._each and now_ns >= self._next_ns:
            self._next_ns = now_ns + PERIOD_NS
            for receiver in self._each.values():
                receiver.sample(now_ns, self.unix_offset_ns)

    def due(self, now_ns: int) -> dict[str, bytes]:
        """What has arrived at the computer since the last call, by name."""
        arrived = {name: receiver.due(now_ns) for name, receiver in self._each.items()}
        return {name: data for name, data in arrived.items() if data}


def _antenna(platform: Platform, name: str) -> tuple[float, float]:
    declared = platform.network_receivers[name]
    return declared.x, declared.y


class Ports:
    """TCP ports on which readers find them."""

    def __init__(self, addresses: Mapping[str, str]) -> None:
        """`addresses`: name -> tcp://HOST:PORT.

        Raises:
            InputError: a port that is busy, or no TCP address.
        """
        self._servers = {name: _listening(name, address) for name, address in addresses.items()}
        self._readers: dict[str, list[_Reader]] = {name: [] for name in addresses}

    def send(self, data: Mapping[str, bytes]) -> None:
        """To whoever reads; takes in new readers."""
        for name, server in self._servers.items():
            self._readers[name] += _accepted(server)
            self._readers[name] = [reader for reader in self._readers[name] if reader.send(data.get(name, b""))]

    def close(self) -> None:
        """End all connections."""
        for closing in (*self._servers.values(), *(r.socket for readers in self._readers.values() for r in readers)):
            closing.close()


class _Reader:
    """One connection, and what it has not taken yet."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket, self._waiting = connection, b""
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes) -> bool:
        """Whether it is still there."""
        self._waiting += data
        try:
            sent = self.socket.send(self._waiting) if self._waiting else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            sent = QUEUE
        self._waiting = self._waiting[sent:]
        if sent == QUEUE or len(self._waiting) > QUEUE:
            self.socket.close()
            return False
        return True


def _listening(name: str, address: str) -> socket.socket:
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    try:
        server = socket.create_server((host, int(port)))
    except (OSError, ValueError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"receivers.{name}.address = {address}: the simulated one cannot listen: {reason}") from None
    server.setblocking(False)
    return server


def _accepted(server: socket.socket) -> Iterable[_Reader]:
    try:
        return [_Reader(server.accept()[0])]
    except OSError:
        return []
