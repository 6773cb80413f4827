"""Results of a diagnosis: the findings, and the report as a whole."""
from __future__ import annotations

from dataclasses import dataclass, field

from ..evaluation.verdict import BETTER, Trust, Verdict
from ..samples import Recording
from .detection import Detection
from .drives import Drives
from .estimate import Estimate
from .held_out import HeldOut
from .measured import MeasuredErrors
from .residuals import Residual
from .tracing import Candidate
from .unexplained import Correlation


@dataclass(frozen=True)
class Finding:
    """An effect that was found.

    group: names of the effects that the recording does not distinguish, itself first. changes: the parameters as the
    correction sets them. reason: why it was not added. seen: what shows it, if it was not fitted. drives: estimates
    from each of several drives, by name. drives_contradict: whether these contradict each other. saves: duration of
    outages, s, and the mean of the largest error in them without it and with it, m, each with the effects that were
    added before.
    since: ns, stamp of the first sample that shows it; 0: unknown. least: part of the sigma of a parameter that does
    not decrease with more samples. settled: not added, and all that may be left does not matter. direct: estimated
    without a filter, as `configure` does.
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
    drives_contradict: bool = False
    saves: tuple[float, float, float] | None = None
    since: int = 0
    least: dict[str, float] = field(default_factory=dict)
    settled: bool = False
    direct: bool = False

    def says_more_than(self, before: Finding) -> bool:
        """Of an effect that may be as it is given: whether this, seen later, says more than `before`, or else."""
        a, b = self.parameters, before.parameters
        differs = any(a[name].differs(b[name]) for name in a.keys() & b.keys())
        return bool(a) and (self.settled or not before.settled or differs)


@dataclass(frozen=True)
class Diagnosis:
    """Result of `diagnose`. Residuals and detections: of the user's filter as configured, with the best noise levels
    alone, and with all corrections; 'search': of the final model of the search, without adaptation, which show what is
    left unexplained.

    noise: factors on noise levels in `corrected`. explained: factors with the highest likelihood of the innovations,
    which are not used in `corrected`. drives: the part of the diagnosis about each of several drives. left_out: by
    name, why other drives are not part of it. correlations: of what is left unexplained with what was recorded.
    """

    recordings: tuple[Recording, ...]
    values: dict
    problem: Drives
    residuals: dict[str, Residual]
    detections: dict[str, Detection]
    noise: dict[str, float]
    explained: dict[str, float]
    rounds: list[list[Candidate]]
    chosen: list[str]  # for each round that tried any, the effect that it added, or the first one tried
    findings: list[Finding]
    hidden: dict[str, str]  # effects and parameters that the data cannot show, and why
    corrected: dict
    verdict: Verdict  # on `corrected`; if that is `values`, on the best correction tried
    tried: str  # what `verdict` is on, in words
    before: MeasuredErrors
    fitted: MeasuredErrors
    after: MeasuredErrors
    comparison: list[dict]  # of the errors that `verdict` is about with those before
    correlations: list[Correlation]
    remarks: list[str] = field(default_factory=list)
    drives: list[Diagnosis] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Names of the recordings."""
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
        """Whether `corrected` differs from `values`, as something is proven on held-out data."""
        return self.corrected != self.values

    @property
    def trust(self) -> Trust:
        """Whether the sigmas of the filter with `corrected` can be trusted."""
        return self.after.trust(self.residuals['after'].nis()[self.problem.mask])

    @property
    def unexplained(self) -> bool:
        return self.detections['search'].lacking or bool(self.correlations)
