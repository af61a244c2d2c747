"""Fresh hostile cases by the thousand: counts by kind and outcome, and failures as folders.

    python tests/hostile/campaign.py --cases 20000 --seed 7 -o campaign

The exit status is 1 if anything failed. The same seed makes the same cases.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import hypothesis
from hostile import strategies
from hostile.cases import verdict
from hostile.runner import Runner


def run(kind: str, count: int, seed: int, folder: Path) -> tuple[Counter, list[str], float]:
    """Read so many cases of a kind; outcomes by their labels, and failures in words."""
    outcomes: Counter = Counter()
    failures: list[str] = []
    seen: set[bytes] = set()
    began = time.monotonic()

    with Runner() as runner:

        @hypothesis.seed(seed)
        @hypothesis.settings(
            max_examples=4 * count,  # Hypothesis makes some cases twice
            deadline=None,
            database=None,
            phases=[hypothesis.Phase.generate],
            suppress_health_check=list(hypothesis.HealthCheck),
        )
        @hypothesis.given(strategies.BY_KIND[kind]())
        def each(case):
            mark = hashlib.sha256(repr((case.files, case.options)).encode()).digest()
            if mark in seen or len(seen) == count:
                return
            seen.add(mark)
            answer = runner.run(case)
            failed = verdict(case, answer)
            how = case.label.rpartition("/")[2]
            outcomes[how, "FAILED" if failed else answer.outcome] += 1
            if failed:
                failures.append(f"{case.label}: {failed}")
                _keep(folder / f"{kind}{len(failures)}", case, failed)

        each()
    return outcomes, failures, time.monotonic() - began


def _keep(folder: Path, case, failed: str) -> None:
    """Write a case that failed."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in case.files.items():
        if isinstance(content, bytes):
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    said = {"case": repr(case), "main": case.main, "failed": failed}
    (folder / "CASE.json").write_text(json.dumps(said, indent=2) + "\n", encoding="utf-8")


def main() -> int:
    """Run it; the exit status is 1 if a case failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=20000, help="how many, all kinds together")
    parser.add_argument("--seed", type=int, default=0, help="of the draws (0)")
    parser.add_argument("--kinds", nargs="+", choices=strategies.BY_KIND, help="only these")
    parser.add_argument("--jobs", type=int, default=2, help="processes (2)")
    parser.add_argument("-o", "--output", type=Path, default=Path("campaign"), help="for failures")
    given = parser.parse_args()
    kinds = given.kinds or list(strategies.BY_KIND)
    whole = sum(strategies.SHARES[kind] for kind in kinds)
    ran = failed = 0
    with ProcessPoolExecutor(given.jobs) as pool:
        jobs = {
            kind: pool.submit(
                run,
                kind,
                max(1, round(given.cases * strategies.SHARES[kind] / whole)),
                given.seed,
                given.output / f"seed{given.seed}",
            )
            for kind in kinds
        }
        for kind, job in jobs.items():
            outcomes, failures, seconds = job.result()
            ran, failed = ran + outcomes.total(), failed + len(failures)
            print(f"{kind}: {outcomes.total()} cases in {seconds:.0f} s")
            for (how, outcome), count in sorted(outcomes.items()):
                print(f"    {how:<10} {outcome:<9} {count}")
            for failure in failures:
                print(f"  FAILED {failure}")
            sys.stdout.flush()
    print(f"seed {given.seed}: {ran} cases, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
