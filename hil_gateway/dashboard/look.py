"""The look that all pages share: live page, comparison and reports. `page/look.css` owns the colours."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache

from hil_gateway.process.shipped import shipped

_COLOUR = re.compile(r"--([a-z-]+):\s*(#[0-9a-f]{6})")


@cache
def look() -> str:
    """The shared stylesheet, to be put into a page that stands alone."""
    return shipped("hil_gateway", "dashboard/page/look.css").read_text()


@cache
def light_colours() -> Mapping[str, str]:
    """Name -> #rrggbb of the light theme, for figures on white paper."""
    light = look().split(':root[data-theme="light"]', 1)[1].split("}", 1)[0]
    return dict(_COLOUR.findall(light))
