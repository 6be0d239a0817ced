"""Armed means under way within 2 s, or the reason is said: everything on the virtual clock, from drawn places."""

from __future__ import annotations

from itertools import islice

import pytest
from support.promise_figures import record_figure, volume

from benchmarks.campaign.places import drawn, trial
from hil_gateway.track.loading import shipped_tracks


@pytest.mark.promise("G3")
@pytest.mark.slow
def test_armed_means_under_way_within_2_s_or_the_reason_is_said() -> None:
    outcomes = [trial(place) for place in islice(drawn(0, sorted(shipped_tracks())), volume(2, 1000))]
    assert [outcome for outcome in outcomes if not outcome.kept] == []
    moved = [outcome for outcome in outcomes if outcome.moved_after_s is not None]
    assert len(moved) > len(outcomes) / 2
    assert [outcome for outcome in outcomes if outcome.left_the_road] == []
    record_figure("G3", f"{len(outcomes)} places, all tracks and pit lanes: {len(moved)} under way, the rest told why")
