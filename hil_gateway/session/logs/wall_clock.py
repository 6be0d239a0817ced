"""Dates as loggers write them, in the language and order of their machine.

None says which zone its clock is in. It is taken as UTC, so that two logs of one drive agree whatever they are in and
wherever they are read.
"""

from __future__ import annotations

import re
import unicodedata
from datetime import UTC, datetime, timedelta

from hil_gateway.process.clock import NS_PER_S
from hil_gateway.session.logs.entry import nanoseconds

MONTHS = (
    ("jan", "gen", "ene", "sty", "led"), ("feb", "fev", "lut", "uno"), ("mar", "mrz", "maa", "mrt", "bre"),
    ("apr", "avr", "abr", "kwi", "dub"), ("may", "mai", "mag", "mei", "maj", "kve"), ("jun", "juin", "giu", "cze"),
    ("jul", "juil", "lug", "lip"), ("aug", "aou", "ago", "sie", "srp"), ("sep", "set", "wrz", "zar"),
    ("oct", "okt", "ott", "out", "paz", "rij"), ("nov", "lis"), ("dec", "dez", "dic", "des", "gru", "pro"),
)  # fmt: skip
"""Beginnings of the names of the months, without accents: English, German, French, Italian, Spanish, Portuguese,
Dutch, Scandinavian, Polish, Czech."""
_TIME = re.compile(r"(\d{1,2})\s?[:h]\s?(\d{2})(?:[:m.]\s?(\d{2}))?(?:[.,:](\d+))?")
_NUMERIC = re.compile(r"(?<!\d)(\d{1,4})[./-](\d{1,2})[./-](\d{1,4})(?!\d)")
_AFTERNOON, _MORNING = re.compile(r"\b(?:pm|p\.\s?m\.?)(?!\w)"), re.compile(r"\b(?:am|a\.\s?m\.?)(?!\w)")
SPREADSHEET_ZERO = datetime(1899, 12, 30, tzinfo=UTC)
"""day 0 of dates that are written as a number of days"""


def parse_date(text: str) -> int | None:
    """Unix ns of a date and time in words or figures, None where it is none."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", text.lower()) if not unicodedata.combining(c))
    clock = _TIME.search(plain)
    if clock is None:
        return None
    day = _day(plain[: clock.start()] + " " + plain[clock.end() :])
    if day is None:
        return None
    hour, minute, second = _hour(int(clock[1]), plain), int(clock[2]), int(clock[3] or 0)
    try:
        whole = datetime(day[0], day[1], day[2], hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return int(whole.timestamp()) * NS_PER_S + nanoseconds(f"0.{clock[4] or 0}")


def _hour(hour: int, text: str) -> int:
    """Some loggers write "pm" behind an hour that counts to 24."""
    if _AFTERNOON.search(text):
        return hour if hour >= 12 else hour + 12
    return 0 if hour == 12 and _MORNING.search(text) else hour


def _day(text: str) -> tuple[int, int, int] | None:
    """(year, month, day)."""
    if found := _NUMERIC.search(text):
        return _by_figures(*map(int, found.groups()), dotted="." in found[0])
    months = [n for word in re.findall(r"[^\W\d_]{3,}", text) if (n := _month(word))]
    if asian := re.search(r"(\d{1,2})\s?月", text):
        months = [int(asian[1])]
        text = text.replace(asian[0], " ")
    years, days = re.findall(r"(?<!\d)\d{4}(?!\d)", text), re.findall(r"(?<!\d)\d{1,2}(?!\d)", text)
    return (int(years[0]), months[-1], int(days[0])) if months and years and days else None


def _by_figures(a: int, b: int, c: int, *, dotted: bool) -> tuple[int, int, int]:
    """2026-11-09, 09.11.2026 and 11/9/2026; where day and month can be either, dots put the day first."""
    if a > 31:
        return a, b, c
    year = c if c > 99 else 2000 + c
    day_first = a > 12 or (dotted and b <= 12)
    return (year, b, a) if day_first else (year, a, b)


def _month(word: str) -> int:
    """1 to 12, or 0; days of the week stand before it in every language, and the last word that fits counts."""
    return next((i for i, starts in enumerate(MONTHS, start=1) if word.startswith(_longest(word, starts))), 0)


def _longest(word: str, starts: tuple[str, ...]) -> tuple[str, ...]:
    """`starts` that `word` can be meant by: the French juin and juillet differ in their fourth letter."""
    return tuple(s for s in starts if not (word.startswith("jui") and len(s) == 3))


def from_days(days: float) -> int:
    """Unix ns of a date as spreadsheets count it."""
    moment = SPREADSHEET_ZERO + timedelta(days=days)
    return round(moment.timestamp() * 1e6) * 1000


def of_day_ns(stamp_ns: int) -> int:
    """ns since midnight."""
    return stamp_ns % (86_400 * NS_PER_S)
