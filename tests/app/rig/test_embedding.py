"""A rig file with the contents of the files that it names."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, registry, writing
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.embedding import embed_rig, embedded_rig
from goniotwin.app.rig.model_hash import model_hash
from tests.conftest import Writer

SUM = """[twin.samples.paint]
model = "sum"
lobes = [{ model = "lambertian", reflectance = 0.1 }, { model = "table", file = "tables/paint.ddr" }]

[twin.samples.etalon]"""


def test_a_rig_on_another_computer_has_the_model_of_this_one(write_rig: Writer, tmp_path: Path) -> None:
    """With the table in a sum, in a folder of its own; its path is on this computer alone."""
    (tmp_path / "tables").mkdir()
    path = tmp_path / "tables" / "paint.ddr"
    values = np.full((1, 1, 2, 2, 3), 0.2)
    table = BsdfTable(np.array([0.0, 90.0]), np.array([0.0, 180.0]), np.array([0.0, 90.0, 180.0]), values)
    writing.write(path, BsdfFile((table,)), registry.format_named("ddr", {registry.Holds.GRID}))
    rig = read_rig(write_rig(("[twin.samples.etalon]", SUM)))
    own = rig.model()
    assert own is not None
    data = json.loads(json.dumps(embed_rig(rig)))
    path.unlink()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    found = embedded_rig(data, elsewhere).model()
    assert found is not None
    assert model_hash(found) == model_hash(own)
    with pytest.raises(UserError, match=r"paint\.ddr: there is no such file"):
        embed_rig(rig)


def test_a_rig_without_tables_is_its_text(write_rig: Writer) -> None:
    rig = read_rig(write_rig())
    assert embed_rig(rig) == {"text": rig.text, "alignment": None, "files": {}}


def test_the_alignment_goes_with_its_rig(write_rig: Writer, tmp_path: Path) -> None:
    rig = replace(read_rig(write_rig()), alignment="the text of an alignment file")
    assert embedded_rig(embed_rig(rig), tmp_path).alignment == rig.alignment
