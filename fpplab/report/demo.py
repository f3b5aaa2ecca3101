"""The page of `fpplab demo`: response, characterisation, and every artefact with its errors."""

from fpplab.report.measurements import write_report
from fpplab.report.page import PageBasis
from fpplab.report.scans import scan_section
from fpplab.results.demo import DemoResult


def write_demo_report(result: DemoResult) -> None:
    write_report(
        result.report_file,
        "Demonstration on the virtual bench",
        head_facts=result.characterisation.facts(),
        response=(result.response, result.levels),
        characterisation=result.characterisation,
        scans=[scan_section(scan.scan, scan.comparison) for scan in result.scans],
        verdicts_and_sources=PageBasis(answer=result.summary()),
    )
