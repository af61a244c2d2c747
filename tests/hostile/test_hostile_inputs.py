"""No hostile input makes a reader crash, hang, show a traceback or make a number up.

What that means, and how a made-up number is recognised, stands in `cases.py`. More cases with fresh
seeds: `campaign.py`.
"""

from __future__ import annotations

import pytest

COUNTS = {
    "image": 1200,
    "field": 800,
    "table": 300,
    "mesh": 80,
    "calibration": 800,
    "scene": 300,
    "call": 500,
    "command": 60,
}
EACH_TIME = 0.05  # of them, wherever tests run; all of them are slow


@pytest.fixture(scope="module")
def runner():
    from hostile.runner import Runner

    with Runner() as started:
        yield started


DEADLY = (
    "seed/huge_extent.vti",
    "seed/huge_points.vtp",
    "seed/negative_extent.vti",
    "seed/wide_extent.vti",
)
"""VTK asks for more memory than there is and ends its process; the next one imports it again.

Without them, tests/medium/imports read such files.
"""


@pytest.mark.parametrize("deadly", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_every_fault_that_was_found_has_its_right_outcome(runner, deadly):
    """The files of bug reports, and those that hostile inputs found in version 0.4."""
    from hostile import seeds
    from hostile.cases import verdict

    cases = [case for case in seeds.every() if (case.label in DEADLY) == deadly]
    assert len(cases) >= len(DEADLY)
    failed = {case.label: verdict(case, runner.run(case)) for case in cases}
    assert {label: said for label, said in failed.items() if said} == {}


def read_all(runner, kind, count):
    """So many cases of a kind, the same in every run."""
    from hostile import strategies  # Hypothesis takes a second to import
    from hostile.cases import verdict
    from hypothesis import HealthCheck, Phase, given, settings

    @settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategies.BY_KIND[kind]())
    def harmless(case):
        assert not verdict(case, runner.run(case))

    harmless()


@pytest.mark.parametrize("kind", COUNTS)
def test_no_hostile_input_does_harm(runner, kind):
    """Some of the cases below."""
    read_all(runner, kind, round(EACH_TIME * COUNTS[kind]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", COUNTS)
def test_of_thousands_of_hostile_inputs_none_does_harm(runner, kind):
    """Thousands of cases."""
    read_all(runner, kind, COUNTS[kind])
