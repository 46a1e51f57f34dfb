"""The report: what it states of a journal, that it needs no other file, and that texts of a journal are texts."""

import base64
import re
import sys
import time  # noqa: TID251  (its zone)
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.verification import Verdict, verify_journal
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.report.report import NO_PANGO, pdf_of, report_html, write_report
from goniotwin.app.data.standard_values import standard_values
from goniotwin.app.errors import GoniotwinError, MissingPackage
from goniotwin.app.formats.file import FormatError
from goniotwin.app.rig import read_rig
from tests.app.campaign.reduction.long_journal import write_long_journal
from tests.app.data.report_values import check_report_values
from tests.conftest import REPOSITORY, RIG, SMALL, changed

pytestmark = pytest.mark.xdist_group("report")

HOSTILE = '<script>alert("1")</script>'


class Page(HTMLParser):
    """The text of a page, its tags, and the addresses that it names."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.alternatives: list[str] = []
        self._parts: list[str] = []
        self._open: list[str] = []
        self.feed(html)
        self.close()
        assert not self._open, f"not closed: {self._open}"

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.append(tag)
        named = dict(attrs)
        self.addresses += [named[key] for key in ("src", "href") if key in named]
        self.alternatives += [named["alt"]] if "alt" in named else []
        if tag not in ("meta", "img", "br"):
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self._open:
            self._parts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self._parts).split())


@pytest.fixture(scope="session")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of a spectrum, with metadata that would act in a page."""
    metadata = (
        f"[metadata]\ntitle = 'A test of {HOSTILE}'\noperator = 'A. Person'\n[metadata.samples.gaussian-5]\nmaker = 'a & b'\n"
    )
    text = changed(
        SMALL + metadata, (("wavelength_nm = [550]", "wavelength_nm = [550, 600]"), ("readings = 2", "readings = 1"))
    )
    path = tmp_path_factory.mktemp("report") / "a.journal"
    run_without_wires(make_plan(parse_schedule(text, "schedule.toml"), read_rig(RIG)), path)
    return path


def test_a_report_states_what_is_known_and_needs_no_other_file(journal: Path, tmp_path: Path) -> None:
    result = write_report(journal, tmp_path / "a.html")
    html = (tmp_path / "a.html").read_text(encoding="utf-8")
    page = Page(html)
    assert all(each.startswith("data:image/") for each in page.addresses)
    assert not re.search(r"url\(|@import|https?://(?!www\.w3\.org)", html)
    assert {"script", "link", "iframe"}.isdisjoint(page.tags)
    assert f"A test of {HOSTILE}" in page.text
    assert "A. Person" in page.text
    assert re.search(r"values gaussian-5: \d+ values, \d+ of them trusted; u above 1 % of the peak: median [\d.]+ %", page.text)
    assert "a & b" in page.text
    assert page.text.count("SIMULATED: measured on a virtual rig (seed 1)") == 1
    assert page.alternatives == [f"{kind} of gaussian-5, simulated" for kind in ("cuts", "hemisphere", "polar", "spectrum")]
    with Journal.open(journal) as opened:
        assert opened.chain.tip in page.text
        for verdict in verify_journal(evaluate_journal(opened)):
            assert " ".join(f"{verdict.name} {verdict.verdict} {verdict.text}".split()) in page.text
    assert "the schedule has no scan of the open beam" in page.text
    for word in (
        "noise floor, 1/sr",
        "field of view, deg",
        "certificate of the etalon (level)",
        "noise of the reading of the etalon (photodiode ",
        "[etalon] relative_uncertainty",
        "dark_readings = 4",
    ):
        assert word in page.text
    assert (result["simulated"], result["samples"]) == (True, ["gaussian-5"])


def test_a_report_of_a_real_rig_is_not_marked(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("goniotwin.app.campaign.journal.reading.JournalReader.simulated", False)
    html, result = report_html(journal, kinds=())
    assert "SIMULATED" not in html
    assert result["simulated"] is False


def test_many_numbers_are_the_first_and_the_last(journal: Path, tmp_path: Path) -> None:
    assert "wavelengths, nm 550, 600 " in Page(report_html(journal, kinds=())[0]).text
    write_long_journal(tmp_path / "many.journal", wavelengths=25, shifts=1)
    assert "wavelengths, nm 25 from 500 to 501.2 " in Page(report_html(tmp_path / "many.journal", kinds=())[0]).text


def test_of_many_reflectances_some_are_listed(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    many = [{"of": f"reflectance {k}", "value": 0.5, "u": 0.01} for k in range(1000)]
    energy = Verdict("energy, gaussian-5", "holds", "", {"reflectances": many})
    monkeypatch.setattr("goniotwin.app.data.report.report.verify_journal", lambda _: [energy])
    page = Page(report_html(journal, kinds=())[0])
    assert 20 < page.text.count("reflectance ") < 40
    assert "reflectance 0 0.5000" in page.text
    assert "reflectance 999 0.5000" in page.text
    assert "24 of 1000; all are in goniotwin verify JOURNAL --json" in page.text


def test_a_file_that_is_no_journal_has_no_report(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("sample,sigma_deg\n", encoding="utf-8")
    with pytest.raises(GoniotwinError, match=r"a\.csv: "):
        report_html(path)


@pytest.fixture
def far_east(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A computer whose time zone is nine hours ahead of UTC."""
    if not hasattr(time, "tzset"):
        pytest.skip("the time zone of a process cannot be set here")
    monkeypatch.setenv("TZ", "XYZ-9")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("far_east")
def test_a_report_begins_with_number_persons_and_times_of_this_zone(journal: Path) -> None:
    html, _ = report_html(journal, kinds=(), number='A-7";} </style>', approved_by="B. Other")
    page = Page(html)
    assert 'report number A-7";} </style> measured by A. Person approved by B. Other measured 2' in page.text
    assert 'content: "report\\20 A\\2d 7\\22 \\3b \\7d \\20 \\3c \\2f style\\3e ";' in html  # no end of a string, and no tag
    with Journal.open(journal) as opened:
        begun = opened.sessions()[0].wall_started
    assert begun.endswith("+00:00")
    assert begun not in page.text
    assert len(re.findall(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC\+09:00", page.text)) == 4


def test_a_report_has_the_values_at_standard_geometries(journal: Path) -> None:
    text = Page(report_html(journal, kinds=())[0]).text
    found = standard_values(open_dataset(journal))
    assert {each.geometry for each in found.values} == {"specular"}
    for each in found.values:
        assert f"{each.bsdf:#.4g} {each.expanded_u:#.2g}" in text
    assert f"Not covered by trusted values: {'; '.join(found.missing)}." in text


@pytest.mark.parametrize("error", [ImportError, OSError])
def test_without_weasyprint_or_pango_the_html_is_beside_the_pdf(
    error: type[Exception], journal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Absent:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "weasyprint":
                raise error

    monkeypatch.delitem(sys.modules, "weasyprint", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Absent(), *sys.meta_path])
    with pytest.raises(MissingPackage) as missing:
        write_report(journal, tmp_path / "a.pdf", kinds=())
    remedy = NO_PANGO if error is OSError else "WeasyPrint is not installed; run pip install 'goniotwin[pdf]'"
    assert str(missing.value) == f"{tmp_path / 'a.pdf'}: {remedy}; the report is in {tmp_path / 'a.html'} instead"
    assert [each.name for each in tmp_path.iterdir()] == ["a.html"]
    assert "certificate of the etalon" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_a_page_of_another_program_is_not_replaced(journal: Path, tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text("<html>mine</html>", encoding="utf-8")
    with pytest.raises(FormatError, match=r"a\.html: "):
        write_report(journal, tmp_path / "a.pdf", kinds=())
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == "<html>mine</html>"


@pytest.mark.long
def test_each_page_of_a_pdf_has_number_and_mark_and_its_values_are_those_of_the_export(journal: Path, tmp_path: Path) -> None:
    pytest.importorskip("weasyprint", reason="the extra `release` is not installed: no PDF")
    pypdf = pytest.importorskip("pypdf", reason="the extra `release` is not installed: no text of a PDF")
    write_report(journal, tmp_path / "a.pdf", number="A-7")
    pages = [" ".join(each.extract_text().split()) for each in pypdf.PdfReader(tmp_path / "a.pdf").pages]
    assert len(pages) > 4
    for number, page in enumerate(pages, 1):
        assert page.startswith("SIMULATED ") or page.endswith("SIMULATED") or " SIMULATED " in page
        assert f"page {number} of {len(pages)}" in page
        assert "report A-7" in page
    text = " ".join(pages)
    assert "measured by A. Person" in text
    open_dataset(journal).save(tmp_path / "a.csv")
    assert check_report_values(text, tmp_path / "a.csv") == 2


@pytest.mark.long
def test_a_pdf_has_no_picture_from_elsewhere(tmp_path: Path) -> None:
    pytest.importorskip("weasyprint", reason="the extra `release` is not installed: no PDF")
    picture = REPOSITORY / "docs" / "pictures" / "report.png"
    embedded = f"data:image/png;base64,{base64.b64encode(picture.read_bytes()).decode()}"
    found = [b"/Subtype /Image" in pdf_of(f"<img src='{each}'>") for each in (embedded, picture.as_uri())]
    assert found == [True, False]
