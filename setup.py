"""Long description of the package: the README, whose links between files lead nowhere on a package page."""

import re
from pathlib import Path

from setuptools import setup

README = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
WITHOUT_FILE_LINKS = re.sub(r"\[([^\]]+)\]\((?!https?:|#)[^)]+\)", r"\1", README)

setup(long_description=WITHOUT_FILE_LINKS, long_description_content_type="text/markdown")
