"""Inertial navigation of the car: extended Kalman filter on IMU, wheel speeds, steering and position fixes.

The IMU drives the prediction, so the filter does not depend on the tyre model it is meant to help identify. State:

    x, y, yaw                      map frame, m and rad
    vx, vy                         body frame at the CoG, m/s
    bias_ax, bias_ay, bias_yaw_rate    IMU biases, m/s2 and rad/s
    wheel_scale                    (indicated wheel speed) / (true) - 1: rolling radius
    slope_share                    share of the declared track map's grade and bank that is real

The yaw rate is the bias-corrected gyro. Gravity on grade and bank comes from the declared track map, which may be
wrong as a whole (a flat road under a hilly map): the share of it that is real is estimated too. Every measurement is
gated by its normalised innovation squared (Bar-Shalom, Estimation with Applications to Tracking, ch. 5).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, sin, sqrt

import numpy as np
import numpy.typing as npt

from hil_gateway.vehicle import Vehicle

Array = npt.NDArray[np.float64]

STATES = ("x", "y", "yaw", "vx", "vy", "bias_ax", "bias_ay", "bias_yaw_rate", "wheel_scale", "slope_share")
X, Y, YAW, VX, VY, BIAS_AX, BIAS_AY, BIAS_YAW_RATE, WHEEL_SCALE, SLOPE_SHARE = range(10)
_EYE = np.eye(10)


@dataclass(frozen=True)
class FilterNoise:
    """Standard deviations; white ones per sample at the IMU rate, SI."""

    accel: float = 0.15
    yaw_rate: float = 0.004
    accel_model: float = 0.15
    """what the map leaves out of gravity, m/s2 per sample"""
    bias_accel_walk: float = 0.01
    """m/s2 per square root of a second"""
    bias_yaw_rate_walk: float = 2e-4
    wheel_scale_walk: float = 5e-4
    slope_share_walk: float = 0.01
    position: float = 0.05
    wheel_speed: float = 0.3
    """per axle, including what stays correlated from sample to sample, m/s"""
    wheel_slip: float = 0.6
    """share of vx * drive by which a driven or braked wheel may slip unseen"""
    rear_slip: float = 0.03
    """rear slip angle on a straight, with what stays correlated from sample to sample, rad"""
    rear_slip_per_ay: float = 0.2
    """growth of the above with lateral acceleration, rad per m/s2"""
    initial_position: float = 0.3
    initial_yaw: float = 0.3
    initial_speed: float = 0.5
    initial_bias_accel: float = 0.2
    initial_bias_yaw_rate: float = 0.01
    initial_wheel_scale: float = 0.01
    initial_slope_share: float = 0.5


@dataclass(frozen=True)
class Imu:
    """One IMU sample with gravity along the body axes from the track map, m/s2 and rad/s."""

    ax: float
    ay: float
    yaw_rate: float
    gravity_x: float = 0.0
    gravity_y: float = 0.0


class StateFilter:
    """Mean and covariance of `STATES`; `initialise` first, then `predict` and updates in order of time."""

    GATE_SIGMA = 5.0
    GATE_POSITION = 25.0
    """chi-square limit of a position fix, two degrees of freedom: one in 3e5 good fixes is refused"""

    def __init__(self, vehicle: Vehicle, noise: FilterNoise | None = None) -> None:
        self.vehicle, self.noise = vehicle, noise or FilterNoise()
        self.mean = np.zeros(len(STATES))
        self.covariance = np.eye(len(STATES))
        self.yaw_rate = 0.0
        self.rejected = 0
        n = self.noise
        self._imu_std = np.array([hypot(n.accel, n.accel_model), hypot(n.accel, n.accel_model), n.yaw_rate])
        walk = (n.bias_accel_walk, n.bias_accel_walk, n.bias_yaw_rate_walk, n.wheel_scale_walk, n.slope_share_walk)
        self._walk_variance = np.array([0.0] * 5 + [w * w for w in walk])

    def initialise(self, x: float, y: float, yaw: float, vx: float = 0.0, yaw_std: float | None = None) -> None:
        """Start at a position fix with a heading that may be wrong by `yaw_std` (default: `initial_yaw`)."""
        n = self.noise
        self.mean = np.array([x, y, yaw, vx, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        yaw_std = n.initial_yaw if yaw_std is None else yaw_std
        std = np.array([
            n.initial_position, n.initial_position, yaw_std, n.initial_speed, n.initial_speed + 0.1 * abs(vx),
            n.initial_bias_accel, n.initial_bias_accel, n.initial_bias_yaw_rate, n.initial_wheel_scale,
            n.initial_slope_share,
        ])  # fmt: skip
        self.covariance = np.diag(std**2)

    def predict(self, imu: Imu, dt: float) -> None:
        """Strap-down step over `dt` s, second order in it (specific force and yaw rate held)."""
        m = self.mean
        yaw, vx, vy = float(m[YAW]), float(m[VX]), float(m[VY])
        r = imu.yaw_rate - float(m[BIAS_YAW_RATE])
        slope = float(m[SLOPE_SHARE])
        ax = imu.ax - float(m[BIAS_AX]) + slope * imu.gravity_x
        ay = imu.ay - float(m[BIAS_AY]) + slope * imu.gravity_y
        c, s = cos(r * dt), sin(r * dt)
        # the specific force turns with the body: over the step it acts half a turn later than at the start
        ch, sh = cos(0.5 * r * dt) * dt, sin(0.5 * r * dt) * dt
        vx1, vy1 = c * vx + s * vy + ch * ax + sh * ay, -s * vx + c * vy - sh * ax + ch * ay
        vxm, vym, ym = 0.5 * (vx + vx1), 0.5 * (vy + vy1), yaw + 0.5 * r * dt
        cy, sy = cos(ym), sin(ym)
        vex, vey = cy * vxm - sy * vym, sy * vxm + cy * vym
        F = _EYE.copy()
        F[X, YAW], F[Y, YAW] = -vey * dt, vex * dt
        F[X, VX], F[X, VY], F[Y, VX], F[Y, VY] = cy * dt, -sy * dt, sy * dt, cy * dt
        F[X, BIAS_YAW_RATE], F[Y, BIAS_YAW_RATE] = 0.5 * dt * dt * vey, -0.5 * dt * dt * vex
        F[YAW, BIAS_YAW_RATE] = -dt
        F[VX, VX], F[VX, VY], F[VY, VX], F[VY, VY] = c, s, -s, c
        F[VX, BIAS_AX], F[VX, BIAS_AY], F[VY, BIAS_AX], F[VY, BIAS_AY] = -ch, -sh, sh, -ch
        F[VX, SLOPE_SHARE] = ch * imu.gravity_x + sh * imu.gravity_y
        F[VY, SLOPE_SHARE] = ch * imu.gravity_y - sh * imu.gravity_x
        F[VX, BIAS_YAW_RATE], F[VY, BIAS_YAW_RATE] = -dt * (c * vy - s * vx), dt * (c * vx + s * vy)
        # IMU noise enters where the biases do (their columns of F), but leaves the biases themselves alone
        noise = F[:, BIAS_AX:WHEEL_SCALE] * self._imu_std
        noise[BIAS_AX:] = 0.0
        P = F @ self.covariance @ F.T + noise @ noise.T
        P.flat[:: len(STATES) + 1] += self._walk_variance * dt
        self.covariance = P
        m[X], m[Y], m[YAW] = m[X] + dt * vex, m[Y] + dt * vey, yaw + r * dt
        m[VX], m[VY] = vx1, vy1
        self.yaw_rate = r

    def update_position(self, x: float, y: float) -> float | None:
        """Position fix of the CoG, m. Returns the normalised innovation squared, None where it was gated out."""
        P, m, variance = self.covariance, self.mean, self.noise.position**2
        ex, ey = x - float(m[X]), y - float(m[Y])
        sxx, sxy, syy = float(P[X, X]) + variance, float(P[X, Y]), float(P[Y, Y]) + variance
        nis = (ex * ex * syy - 2 * ex * ey * sxy + ey * ey * sxx) / (sxx * syy - sxy * sxy)
        if not nis < self.GATE_POSITION:
            self.rejected += 1
            return None
        self._update(_unit(X), ex, variance)
        self._update(_unit(Y), y - float(self.mean[Y]), variance)
        return nis

    def update_wheel_speeds(self, front: float, rear: float, steer: float, drive: float) -> list[float]:
        """Mean circumferential speeds of front and rear wheels, m/s; slip widens their noise. Returns the NIS used."""
        m, n, v = self.mean, self.noise, self.vehicle
        r, vx, vy = self.yaw_rate, float(m[VX]), float(m[VY])
        scale, c, s = 1.0 + float(m[WHEEL_SCALE]), cos(steer), sin(steer)
        rolling = vx * c + (vy + v.lf * r) * s
        H = np.zeros(len(STATES))
        H[VX], H[VY], H[BIAS_YAW_RATE], H[WHEEL_SCALE] = c * scale, s * scale, -v.lf * s * scale, rolling
        slip = n.wheel_slip * vx * drive
        used = [self._gated(H, front - rolling * scale, n.wheel_speed**2 + min(slip, 0.0) ** 2)]
        scale, vx = 1.0 + float(m[WHEEL_SCALE]), float(self.mean[VX])
        H = np.zeros(len(STATES))
        H[VX], H[WHEEL_SCALE] = scale, vx
        used.append(self._gated(H, rear - vx * scale, n.wheel_speed**2 + slip**2))
        return [nis for nis in used if nis is not None]

    def update_rear_slip(self, ay: float) -> float | None:
        """The rear axle hardly slides on a straight: vy - l_r r = 0, the less certain the more the car corners."""
        vx, lr, n = float(self.mean[VX]), self.vehicle.lr, self.noise
        H = np.zeros(len(STATES))
        H[VY], H[BIAS_YAW_RATE] = 1.0, lr
        std = (n.rear_slip + n.rear_slip_per_ay * abs(ay)) * abs(vx) + 0.05
        return self._gated(H, -(float(self.mean[VY]) - lr * self.yaw_rate), std * std)

    def update_standstill(self, imu: Imu) -> None:
        """Wheels at rest: no velocity, no yaw rate; the gyro and the accelerometers show their biases."""
        self._update(_unit(VX), -float(self.mean[VX]), 0.02**2)
        self._update(_unit(VY), -float(self.mean[VY]), 0.02**2)
        n = self.noise
        self._update(_unit(BIAS_YAW_RATE), imu.yaw_rate - float(self.mean[BIAS_YAW_RATE]), n.yaw_rate**2)
        accel_variance = 10 * (n.accel**2 + n.accel_model**2)
        for bias, force, gravity in ((BIAS_AX, imu.ax, imu.gravity_x), (BIAS_AY, imu.ay, imu.gravity_y)):
            H = np.zeros(len(STATES))
            H[bias], H[SLOPE_SHARE] = 1.0, -gravity
            self._update(H, force - float(H @ self.mean), accel_variance)

    def std(self) -> Array:
        """Standard deviations of `STATES`, shape (10,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def yaw_rate_std(self) -> float:
        """Of the bias-corrected gyro, rad/s."""
        return sqrt(max(float(self.covariance[BIAS_YAW_RATE, BIAS_YAW_RATE]), 0.0) + self.noise.yaw_rate**2)

    @property
    def healthy(self) -> bool:
        """Finite mean and covariance."""
        return bool(np.isfinite(self.mean).all() and np.isfinite(self.covariance).all())

    def _gated(self, H: Array, innovation: float, variance: float) -> float | None:
        nis = innovation * innovation / (float(H @ self.covariance @ H) + variance)
        if not nis < self.GATE_SIGMA**2:
            self.rejected += 1
            return None
        self._update(H, innovation, variance)
        return nis

    def _update(self, H: Array, innovation: float, variance: float) -> None:
        """Scalar Kalman update, Joseph form."""
        PH = self.covariance @ H
        K = PH / (float(H @ PH) + variance)
        column = K[:, None]
        A = _EYE - column * H
        P = A @ self.covariance @ A.T + variance * column * K
        self.covariance = 0.5 * (P + P.T)
        change = K * innovation
        self.mean += change
        self.yaw_rate -= float(change[BIAS_YAW_RATE])


def _unit(index: int) -> Array:
    return np.asarray(_EYE[index])


def course(x0: float, y0: float, x1: float, y1: float) -> float:
    """Direction of travel between two position fixes, rad in the map frame."""
    return atan2(y1 - y0, x1 - x0)
