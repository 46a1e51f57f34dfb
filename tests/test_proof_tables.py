"""The tables of proofs in the documents: between their marks, from results, and of the program as it is."""

from pathlib import Path

import pytest

from goniotwin import examples
from goniotwin.app.campaign.proof.pooled import PooledProof, prove_structures
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.sweeps.runners import Here
from goniotwin.linear_algebra import one_thread_in_linear_algebra
from tests.proof_tables import DOCUMENT, MARKED, computed_parts, renewed

TABLES = {each["name"]: each["table"] for each in MARKED.finditer(DOCUMENT.read_text(encoding="utf-8")) if each["table"]}


@pytest.mark.long
@pytest.mark.parametrize("name", TABLES)
def test_a_rig_of_each_table_is_computed_again(name: str) -> None:
    """Each number of its row, to the last digit. Where one differs after a change that is meant: `make proof`."""
    with one_thread_in_linear_algebra():
        rows = computed_parts(TABLES[name])
    assert rows
    for row in rows:
        assert row in TABLES[name]


def test_a_table_is_written_between_its_marks_and_read_again(tmp_path: Path) -> None:
    proof = PooledProof(read_rig(examples.FOLDER / "proof" / "rig.toml"), 1, 1, tmp_path / "results", wires=False)
    prove_structures(proof, Here())
    text = "before\n<!-- proof: structures -->\nold\n<!-- end of the proof -->\nafter <!-- proof: lobes -->\n"
    new = renewed(text, [proof.folder])
    assert new.startswith(
        "before\n<!-- proof: structures -->\n`goniotwin prove --structures 1 --rigs 1 --without-wires`, by goniotwin "
    )
    assert new.endswith("<!-- end of the proof -->\nafter <!-- proof: lobes -->\n")
    found = MARKED.search(new)
    assert found is not None
    with one_thread_in_linear_algebra():
        assert [row in found["table"] for row in computed_parts(found["table"])] == [True]
    assert "| seed 1000 alone | " in found["table"]
    with pytest.raises(UserError, match="has no mark <!-- proof: structures --> for"):
        renewed("nothing", [proof.folder])
