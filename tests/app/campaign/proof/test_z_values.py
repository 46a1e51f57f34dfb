"""A regression test of values and their u: deviations from the truth, in u, against a stored copy.

It shows that nothing has changed, on four structures with three rigs each. It cannot show that an interval of 95 % covers 95 %:
twelve rigs are too few for that, and a copy of what is wrong agrees with it. The proofs show it
(docs/physics/uncertainty-proofs.md).
"""

import numpy as np
import pytest

from tests.app.campaign.proof.z_values import FILE, RIGS, STRUCTURES, z_values


@pytest.mark.long
def test_the_deviations_in_u_are_the_stored_ones() -> None:
    """To 1e-6 u. After a change that is meant: `python -m tests.app.campaign.proof.z_values`."""
    found = z_values()
    with np.load(FILE) as stored:
        assert found.keys() == {*stored.files}
        for name, z in found.items():
            assert z.shape == stored[name].shape, name
            assert np.all(np.abs(z - stored[name]) < 1e-6), name
    assert len({name.split()[0] for name, z in found.items() if z.size}) == RIGS * len(STRUCTURES)
