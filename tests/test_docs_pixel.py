"""The walk through the code in docs/pixel.md leads to the lines that it names."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "pixel.md"
LINKS = re.findall(r"\[`(\w+)`\]\((\S+?)#L(\d+)\)", PAGE.read_text(encoding="utf-8"))


@pytest.mark.parametrize(("name", "path", "line"), LINKS)
def test_links_lead_to_what_they_name(name, path, line):
    lines = (PAGE.parent / path).read_text(encoding="utf-8").splitlines()
    assert re.search(rf"(def|class) {name}\b", lines[int(line) - 1])


def test_the_walk_is_short():
    assert len(PAGE.read_text(encoding="utf-8").splitlines()) <= 120
