"""A result of a tolerance study whose numbers are made up: with values beyond the limit, without a value, and long names."""

import math

from goniotwin.app.desktop.model.tolerances import CELLS, DeviationResult, Distribution, StudyOutcome


def made_distribution(
    name: str, largest_percent: float, *, drawn: bool = False, alone_percent: float | None = 4.8
) -> Distribution:
    """A criterion that is evenly distributed from 0 to its largest value."""
    shares = tuple((limit, min(limit / largest_percent, 1.0), 0.004 if drawn else 0.0) for limit in (5.0, 10.0))
    return Distribution(
        name,
        20_000 if drawn else 531_441,
        not drawn,
        0.5 * largest_percent,
        largest_percent,
        shares,
        largest_percent,
        tuple((number + 1) / CELLS for number in range(CELLS)),
        0.6,
        alone_percent,
        None if drawn else 5.0 / largest_percent,
    )


def made_outcome(*, slopes: bool = True) -> StudyOutcome:
    """A study of 30 deviations with a variant and a yield; `slopes`: with the sensitivities of a lobe."""
    deviations = []
    for number in range(30):
        title = f"output condenser {'rx' if number % 2 else 'x'}{number}"
        minus = math.inf if number == 7 else 0.3 * number
        found = (0.1 * number - 1.0, -0.05 * number, 0.2 * number) if slopes else (None, None, None)
        unit, alone = "deg" if number % 2 else "mm", math.inf if number < 3 else 0.06
        deviations.append(DeviationResult(title, unit, 0.05, 0.025, minus, 0.31 * number, alone, 2.0, 0.0213, 0.0247, *found))
    return StudyOutcome(
        name="made",
        quantity="relative RMS (formula 5)",
        within=(5.0, 10.0),
        deviations=tuple(deviations),
        distributions=(
            made_distribution("30 deviations", 20.0),
            made_distribution("the paper's elements, with shifts and a collimated beam", 8.0),
            made_distribution("yield, uniform", 12.5, drawn=True, alone_percent=None),
        ),
        summary="Alone at most 8.99 % (output condenser rx29). Together 25.0 % of 531,441 combinations are within 5 %: median "
        "10.00 %, worst corner 20.00 %. None fails within 0.250 of the limits: ±0.0125 deg and ±0.0063 mm. About the measured "
        "peak the worst corner is 0.62 %.",
        text="SIMULATED: made\n" + "x" * 100,
        files={"made.txt": b"SIMULATED", "made.png": b"\x89PNG"},
    )
