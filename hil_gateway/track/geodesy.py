"""Latitude and longitude to the local map frame and back.

The map is the east-north plane tangent to the WGS 84 ellipsoid at the configured origin (ENU, EPSG 9837),
evaluated on the ellipsoid's surface: within 5 km the height left out changes x and y by less than a
millimetre per metre of it.
"""

from __future__ import annotations

import math

from hil_gateway.config import OriginConfig

SEMI_MAJOR_AXIS = 6_378_137.0
"""WGS 84 equatorial radius, m."""
FLATTENING = 1 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)
INVERSE_ITERATIONS = 3
"""Fixed-point steps of the inverse; each gains about three digits at 10 km from the origin."""

REACH = 20e3
"""m to either side of its origin that a map reaches; a receiver reports 0, 0 before its first fix"""


class LocalMap:
    """Local map frame: x east, y north of the origin, m."""

    def __init__(self, origin: OriginConfig) -> None:
        self._latitude = math.radians(origin.latitude)
        self._longitude = math.radians(origin.longitude)
        self._sin, self._cos = math.sin(self._latitude), math.cos(self._latitude)
        self._origin_x, self._origin_z = _meridian_point(self._sin, self._cos)
        w = math.sqrt(1 - ECCENTRICITY_SQUARED * self._sin**2)
        self._meridian_radius = SEMI_MAJOR_AXIS * (1 - ECCENTRICITY_SQUARED) / w**3
        self._normal_radius = SEMI_MAJOR_AXIS / w

    def to_map(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Degrees to (x, y), m: rotation of the earth-centred difference vector into east and north."""
        return self.to_map_radians(math.radians(latitude), math.radians(longitude))

    @staticmethod
    def holds(x: float, y: float) -> bool:
        """Whether a point may be a place of this map."""
        return max(abs(x), abs(y)) <= REACH

    def to_geodetic(self, x: float, y: float) -> tuple[float, float]:
        """(x, y), m, to (latitude, longitude), degrees: inverse of `to_map` by fixed-point iteration."""
        latitude, longitude = self._latitude, self._longitude
        for _ in range(INVERSE_ITERATIONS + 1):
            reached_x, reached_y = self.to_map_radians(latitude, longitude)
            longitude += (x - reached_x) / (self._normal_radius * math.cos(latitude))
            latitude += (y - reached_y) / self._meridian_radius
        return math.degrees(latitude), math.degrees(longitude)

    def to_map_radians(self, latitude: float, longitude: float) -> tuple[float, float]:
        """`to_map` from radians."""
        radius, z = _meridian_point(math.sin(latitude), math.cos(latitude))
        turn = longitude - self._longitude
        outward = radius * math.cos(turn) - self._origin_x
        return radius * math.sin(turn), self._cos * (z - self._origin_z) - self._sin * outward


def _meridian_point(sin_latitude: float, cos_latitude: float) -> tuple[float, float]:
    """Distance from the earth's axis and from the equatorial plane of a point on the ellipsoid, m."""
    normal = SEMI_MAJOR_AXIS / math.sqrt(1 - ECCENTRICITY_SQUARED * sin_latitude**2)
    return normal * cos_latitude, normal * (1 - ECCENTRICITY_SQUARED) * sin_latitude
