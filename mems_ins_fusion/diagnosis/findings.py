"""What a diagnosis says: things that were traced, and all that it found."""
from __future__ import annotations

from dataclasses import dataclass, field

from ..evaluation.verdict import BETTER, Trust, Verdict
from ..samples import Recording
from .detection import Detection
from .drives import Drives
from .estimate import Estimate
from .held_out import HeldOut
from .measured import Measured
from .residuals import Residual
from .tracing import Candidate
from .unexplained import GoesWith


@dataclass(frozen=True)
class Finding:
    """One thing that was traced.

    group: names of what the recording cannot tell it from, itself first. changes: the parameters as the correction
    sets them. reason: why it was not added. seen: where it was not fitted, what shows it. drives: what each of several
    drives says alone, by name. apart: the drives contradict each other. saves: duration of outages, s, and the
    median of the largest error without it and with it, m, each beside what was found before. since: ns, stamp of the
    first sample that shows it; 0: nobody says. least: the part of the sigma of a parameter that no more samples lessen.
    """

    name: str
    group: list[str]
    parameters: dict[str, Estimate]
    gain: float
    p: float
    added: bool
    held_out: HeldOut
    reason: str = ''
    changes: dict = field(default_factory=dict)
    seen: str = ''
    drives: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    apart: bool = False
    saves: tuple[float, float, float] | None = None
    since: int = 0
    least: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found. Residuals and detections: of the filter of the user as configured, with the noise levels
    alone that predict best, and with all that was found; 'search': of the best model of the search, which hides nothing
    and is what is left unexplained.

    noise: factors on noise levels in `corrected`. explained: those with which the innovations are explained best, and
    which no filter has to use. drives: the same diagnosis as it looks in each of several drives. left_out: why other
    drives are not in it, by name.
    """

    recordings: tuple[Recording, ...]
    values: dict
    problem: Drives
    residuals: dict[str, Residual]
    detections: dict[str, Detection]
    noise: dict[str, float]
    explained: dict[str, float]
    rounds: list[list[Candidate]]
    chosen: list[str]  # the candidate that each round tried to add; none in the last one
    findings: list[Finding]
    hidden: dict[str, str]  # effects and parameters that the data cannot show, and why
    corrected: dict
    verdict: Verdict  # on `corrected`; where that is `values`, on the best of what was tried
    before: Measured
    fitted: Measured
    after: Measured
    comparison: list[dict]  # of the errors that `verdict` is about with those before
    rest: list[GoesWith]
    remarks: list[str] = field(default_factory=list)
    drives: list[Diagnosis] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the recordings."""
        return ', '.join(recording.name for recording in self.recordings)

    @property
    def recording(self) -> Recording:
        """The recording of a diagnosis of one drive, the first one of several."""
        return self.recordings[0]

    @property
    def better(self) -> bool:
        """Whether errors are proven to be smaller with `corrected`."""
        return self.verdict.answer == BETTER

    @property
    def changed(self) -> bool:
        """Whether `corrected` differs from `values`: it holds what held-out data prove, or is better."""
        return self.corrected != self.values

    @property
    def trust(self) -> Trust:
        """Whether the sigmas of the filter with `corrected` can be trusted."""
        return self.after.trust(self.residuals['after'].nis()[self.problem.mask])

    @property
    def unexplained(self) -> bool:
        return self.detections['search'].lacking or bool(self.rest)
