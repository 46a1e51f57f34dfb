"""Groups of tests: each is one worker's, also where fixtures make it."""

import pytest


@pytest.mark.xdist_group("groups of tests")
def test_a_group_is_known_to_the_worker(request: pytest.FixtureRequest) -> None:
    """Of pytest-xdist the suffix of the name; some versions of pytest lose it, and nothing else fails then."""
    if not getattr(request.config.option, "loadgroup", False):
        pytest.skip("no workers, or others than those of groups")
    assert request.node.nodeid.endswith("@groups of tests")


@pytest.mark.endpoint
def test_what_is_marked_as_an_endpoint_is_one_group(request: pytest.FixtureRequest) -> None:
    marks = [mark.args for mark in request.node.iter_markers("xdist_group")]
    assert marks == [("endpoint",)]
