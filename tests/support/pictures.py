"""Pictures for the documents, out of a real run: `PYTHONPATH=tests python -m support.pictures SESSION docs/pictures`.

The session needs two laps. The page is drawn by the Chromium of this computer, as a user would see it.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from support.browser import Browser
from support.serving import served

from hil_gateway.dashboard.compare_page import page
from hil_gateway.dashboard.recording import Recording, create_app
from hil_gateway.session.files.configuration import recorded_config
from hil_gateway.session.overview.lap_table import read_lap
from hil_gateway.track.loading import load_track

SETTLE_S = 2.5
"""fonts, charts and the first answers of the server"""


def take(session: Path, folder: Path) -> None:
    """Write page.png, page-light.png, phone.png and compare.png into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    config = recorded_config(session)
    track = load_track(config.track)
    recording = Recording(session, track, config)
    moment = 0.8 * (recording.times[-1] - recording.times[0])
    with served(create_app(recording, track, config)) as url:
        picture(f"{url}?t={moment}&theme=dark", folder / "page.png", (1600, 1000))
        picture(f"{url}?t={moment}&theme=light", folder / "page-light.png", (1600, 1000))
        picture(f"{url}?t={moment}&theme=light", folder / "phone.png", (390, 844))
    with tempfile.TemporaryDirectory() as scratch:
        html = Path(scratch) / "compare.html"
        html.write_text(page(read_lap(session, track, 1), read_lap(session, track, 2), track))
        picture(html.as_uri(), folder / "compare.png", (1500, 1000))


def picture(url: str, target: Path, size: tuple[int, int]) -> None:
    """One picture of a page at a size, pixels."""
    with tempfile.TemporaryDirectory() as profile, Browser(Path(profile) / "p", f"{size[0]},{size[1]}") as browser:
        browser.resize(*size)
        browser.open(url)
        browser.wait_for("document.querySelectorAll('.uplot').length > 3")
        time.sleep(SETTLE_S)
        browser.screenshot(target)


if __name__ == "__main__":
    take(Path(sys.argv[1]), Path(sys.argv[2]))
