"""docs/analyse/python.ipynb: it is kept without outputs, and it runs on the bundled example."""

import ast
import re
from pathlib import Path

import nbformat
import pytest

import goniotwin
from tests.conftest import REPOSITORY

NOTEBOOK = REPOSITORY / "docs" / "analyse" / "python.ipynb"


def cells() -> list[str]:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
    return [cell.source for cell in notebook.cells if cell.cell_type == "code"]


def test_it_has_no_outputs_and_the_public_names_alone() -> None:
    source = re.sub(r"^%.*$", "", "\n".join(cells()), flags=re.MULTILINE)
    used = {
        node.attr
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "g"
    }
    assert {"open", "simulate", "compare", "plot", "theory", "GoniotwinError"} <= used <= set(dir(goniotwin))


@pytest.mark.long
def test_it_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # those of Jupyter's own packages
        from nbclient import NotebookClient

        monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
        notebook = nbformat.read(NOTEBOOK, as_version=4)
        done = NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in done.cells for output in cell.get("outputs", [])]
    text = "".join(str(output.get("text", output.get("data", {}).get("text/plain", ""))) for output in outputs)
    assert "sigma_deg 45" in text
    assert "the nearest are 30 and 60" in text
    percent = float(re.findall(r"relative RMS \(formula 5\) ([0-9.]+) %: in the plane of incidence, theta to 10", text)[0])
    assert percent < 2.0
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert (tmp_path / "quick.journal").exists()
