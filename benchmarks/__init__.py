"""The laboratory: what judges and studies the product. Not part of the wheel; runs from a checkout."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # helpers of tests/support, where they serve both
