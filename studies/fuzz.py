"""Spoiled input for every reader for as long as asked, and how it went, for docs/robustness.md.

    python studies/fuzz.py --minutes 60 [--seed 0] [--recordings]

With --recordings whole recordings of absurd but well-formed content, through `configure`, `diagnose` (with topics only
and with the file of `configure`), replays and `characterize`; some ten a minute. Each input is read in a process of its
own; what fails is told with its seed, and exit status 1.
"""
from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from fuzz_support import LONGEST, cases, outcome, recordings  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--seed', type=int, default=0, help='of the first input; the next ones count up')
    parser.add_argument('--recordings', action='store_true', help='whole recordings instead of damaged files')
    options = parser.parse_args()
    began, counts, worst, failed = time.monotonic(), Counter(), defaultdict(lambda: (0.0, 0.0)), 0
    with tempfile.TemporaryDirectory() as folder:
        inputs = recordings if options.recordings else cases
        for name, work, *longest in inputs(Path(folder), options.seed):
            longest = longest[0] if longest else LONGEST
            found = outcome(work, longest)
            kind = name.split(',')[0]
            counts[kind, 'read' if found.status == 0 else 'refused'] += 1
            worst[kind] = max(worst[kind][0], found.seconds), max(worst[kind][1], found.memory)
            complaint = found.complaint(longest)
            if complaint:
                failed += 1
                print(f'{name}: {complaint}', flush=True)
            if time.monotonic() - began > 60 * options.minutes:
                break
    print(f'{sum(counts.values())} inputs in {(time.monotonic() - began) / 60:.0f} minutes from seed {options.seed}, '
          f'{failed} failed\n\n'
          '| input | read | refused in one line | longest, s | most memory, MB |\n|---|---|---|---|---|')
    for kind, (seconds, memory) in sorted(worst.items()):
        print(f'| {kind} | {counts[kind, "read"]} | {counts[kind, "refused"]} | {seconds:.1f} | {1e3 * memory:.0f} |')
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
