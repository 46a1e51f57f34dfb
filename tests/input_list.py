"""The list of declared inputs in docs/physics/inputs.md; `make tables` renews it."""

from pathlib import Path

from goniotwin.app.rig.inputs import inputs

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "physics" / "inputs.md"
HEAD = "| key | default | of what | quantities | one value for |\n|---|---|---|---|---|\n"
MOST_NAMED = 4


def renewed(text: str) -> str:
    """The text of the document with the inputs that are declared now in its list."""
    rows = []
    for each in inputs():
        names = [f"`{name}`" for name in each.targets or (each.name,)]
        quantities = ", ".join(names) if len(names) < MOST_NAMED else f"{names[0]} to {names[-1]}"
        if each.u is not None:
            default = f"{each.u:g}".replace("e-0", "e-")
            rows.append(f"| `{each.key}` | {default} | {each.text} | {quantities} | {each.shared_by.value} |\n")
    before, _, after = text.partition(HEAD)
    return before + HEAD + "".join(rows) + after[after.index("\n\n") + 1 :]


if __name__ == "__main__":
    DOCUMENT.write_text(renewed(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
