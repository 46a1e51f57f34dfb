"""The cycle of docs/analyse/figures.md, by its commands: measure, convert, rehearse with the table as a sample, compare."""

import json
import re
import shlex
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY
from tests.system.command import invoke

PAGE = (REPOSITORY / "docs" / "analyse" / "figures.md").read_text(encoding="utf-8")


@pytest.mark.long
def test_a_measured_table_is_measured_again_within_its_uncertainty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```sh\n(goniotwin examples.*?)```", PAGE, re.DOTALL)
    for line in block.splitlines():
        program, *arguments = shlex.split(line)
        assert program == "goniotwin"
        done = invoke(*arguments)
        assert done.returncode == 0, f"{line}: {done.stderr}"
    found = json.loads(done.stdout)
    assert [each["sigma_deg"] for each in found["lights"]] == [0.0, 30.0, 60.0]
    assert all(each["share_within_2_u"] == 1.0 for each in found["lights"])
    assert all(each["largest_abs_z"] < 1.0 for each in found["lights"])
    assert found["formula_5"]["percent"] < 1.0
    assert sum(each["directions"] for each in found["lights"]) >= 100
    assert (tmp_path / "cycle.png").stat().st_size > 10_000
    assert (tmp_path / "measured.html").exists()
