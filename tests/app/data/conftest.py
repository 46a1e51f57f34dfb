"""A journal of one sample and one incidence, from the golden files."""

import shutil
from pathlib import Path

import pytest

import goniotwin
from tests.conftest import REPOSITORY

JOURNAL = REPOSITORY / "tests" / "golden" / "data" / "finished.journal"


@pytest.fixture(scope="session")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("journal") / "finished.journal"
    shutil.copy(JOURNAL, path)
    return path


@pytest.fixture(scope="session")
def dataset(journal: Path) -> goniotwin.Dataset:
    return goniotwin.open(str(journal))
