"""The pages of `fpplab characterise`: a calibration from poses, and the judgement of one."""

from pathlib import Path

from fpplab.report.devices import judgement_verdict
from fpplab.report.measurements import write_report
from fpplab.report.page import PageBasis
from fpplab.report.parts import PageVerdict
from fpplab.results.characterisation import CharacterisationResult, JudgementResult


def write_characterisation_report(path: Path, result: CharacterisationResult) -> None:
    verdicts = (PageVerdict.of(result.diagnosis),)
    write_report(
        path,
        f"Characterisation {path.stem}",
        head_facts=result.characterisation.facts(),
        characterisation=result.characterisation,
        guided=result.guided,
        verdicts_and_sources=PageBasis(verdicts, {"poses": result.provenance}, result.figures()),
    )


def write_judgement_report(path: Path, name: str, result: JudgementResult) -> None:
    verdicts = (judgement_verdict(result.judgement),)
    basis = PageBasis(verdicts, {"poses": result.provenance}, result.figures())
    write_report(path, f"Judgement of {name}", judgement=result.judgement, verdicts_and_sources=basis)
