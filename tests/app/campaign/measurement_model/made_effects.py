"""Values with shared inputs of a known law: made effects, and errors drawn from them."""

import numpy as np

from goniotwin.app.campaign.measurement_model.effects import Dense, Effects, Group
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.arrays import Floats, Ints


def made_input(name: str, u: float) -> InputQuantity:
    """A relative input."""
    return InputQuantity(name, "1", u, "normal", "some values", "a test", "")


def made_effects(seed: int, values: int = 60, dense: int = 4, members: int = 7) -> Effects:
    """Values with two independent parts, dense inputs, and three groups: one that overlaps, one that is held twice."""
    rng = np.random.default_rng(seed)

    def group(name: str, count: int, columns: int) -> Group:
        inputs = {k: made_input(f"{name}[{k}]", float(rng.uniform(0.5e-3, 5e-3))) for k in range(count)}
        member: Ints = rng.integers(-1, count, (values, columns))
        return Group(name, inputs, member, rng.uniform(-2.0, 2.0, member.shape))

    shared = [made_input(f"dense {k}", float(rng.uniform(0.01, 0.1))) for k in range(dense)]
    return Effects(
        rng.uniform(0.1, 5.0, values),
        {"noise": rng.uniform(1e-7, 1e-5, values), "resolution": np.full(values, 1e-8)},
        [group("reading", 3 * members, 1), group("lamp", members, 1), group("gain", members, 2)],
        [Dense(shared, rng.normal(0.0, 0.1, (values, dense)))],
    )


def dense_sensitivities(effects: Effects) -> Floats:
    """Sensitivities (n, inputs) times u of all shared inputs, by the definition of each: slow, and independent of the fit."""
    columns = [part.sensitivity[:, k] * each.u for part in effects.dense for k, each in enumerate(part.inputs)]
    for group in effects.groups:
        for number, each in group.inputs.items():
            columns.append(np.sum(np.where(group.member == number, group.sensitivity, 0.0), axis=1) * each.u)
    return np.stack(columns, axis=1)


def drawn_errors(effects: Effects, seed: int) -> Floats:
    """Relative errors (n,) with the law that the effects state."""
    rng = np.random.default_rng(seed)
    shared = dense_sensitivities(effects)
    own = np.sqrt(np.sum(list(effects.independent.values()), axis=0))
    drawn: Floats = shared @ rng.normal(size=shared.shape[1]) + own * rng.normal(size=own.size)
    return drawn
