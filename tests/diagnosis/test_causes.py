"""A cause is one file: adding it changes verdicts, documentation and reports; limits are values of a file."""

import gc
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from docs.generate.tables import causes_page
from fpplab.core.config import field_descriptions
from fpplab.core.errors import ConfigError
from fpplab.diagnosis import Verdict, causes, diagnose_frames, known_causes, load_limits
from fpplab.diagnosis.catalogue import limit_sections
from fpplab.diagnosis.causes.saturated import SATURATED
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.record import load_diagnosis, save_diagnosis
from fpplab.report.evidence import evidence_report
from tests.diagnosis.scenes import Bench
from tests.diagnosis.test_diagnosis import measured

ODD_FRAMES = '''
"""The image has an odd number of frames."""

from fpplab.diagnosis.evidence import Needs
from fpplab.diagnosis.finding import Detector, FaultCause, Finding, Picture, DetectionStage
from fpplab.diagnosis.limits import CountLimit, LimitsSection
from fpplab.diagnosis.pictures import draw_rate


class OddFramesLimits(LimitsSection):
    """How many frames there may be."""

    max_frames: CountLimit = 1
    """Frames of a recording. Chosen: for a test."""


def _find(evidence, found):
    count, limit = len(evidence.frames.recording.frames), evidence.limits.of(OddFramesLimits).max_frames
    if count > limit:
        yield Finding(ODD_FRAMES, f"there are {count} frames (at most {limit})", count / limit)


ODD_FRAMES = FaultCause(
    key="odd_frames",
    meaning="There are too many frames.",
    remedy="take fewer",
    measured="number of frames",
    limit=f"{OddFramesLimits().max_frames}",
    seen_in="frames",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=Picture(Needs.FRAMES, draw_rate),
)
'''


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The package of causes with one more file."""
    (tmp_path / "odd_frames.py").write_text(ODD_FRAMES)
    monkeypatch.setattr(causes, "__path__", [*causes.__path__, str(tmp_path)])
    known_causes.cache_clear()
    yield "odd_frames"
    del sys.modules[f"{causes.__name__}.odd_frames"]
    delattr(causes, "odd_frames")
    known_causes.cache_clear()
    gc.collect()


@pytest.mark.whole
def test_a_cause_is_added_by_one_file(added: str, tmp_path: Path) -> None:
    _, _, found = measured(Bench())
    assert found.verdict is Verdict.DOUBTFUL
    assert found.reason == "odd_frames: there are 24 frames (at most 1)"
    assert found.findings[0].remedy == "take fewer"
    (row,) = (line for line in causes_page().splitlines() if line.startswith("| `odd_frames` |"))
    assert "There are too many frames. *Remedy:* take fewer." in row
    assert "number of frames. *Limit:* 1. *Seen in:* frames." in row
    (figure,) = evidence_report(found.findings, Evidence(Bench().recording()))
    assert figure.caption == "Odd frames: there are 24 frames (at most 1)."
    assert added in limit_sections()
    save_diagnosis(found, tmp_path)
    kept = load_diagnosis(tmp_path)
    assert kept is not None
    assert kept.diagnosis().findings[0].cause is known_causes()[added]


def test_keys_are_those_of_the_modules_and_texts_are_whole() -> None:
    for key, cause in known_causes().items():
        assert key == cause.key
        assert all((cause.meaning, cause.remedy, cause.measured, cause.limit, cause.seen_in)), key
        assert cause.meaning.endswith("."), key


def test_every_limit_says_where_it_comes_from() -> None:
    for section, kind in limit_sections().items():
        descriptions = field_descriptions(kind)
        for name in kind.model_fields:
            words = descriptions.get(name, "")
            assert any(source in words for source in ("Derived", "Measured", "Chosen")), (section, name)


@pytest.mark.whole
def test_limits_of_a_file_are_used_and_stay_with_the_verdict(tmp_path: Path) -> None:
    path = tmp_path / "limits_bright.yaml"
    path.write_text("exposure:\n  max_saturated_share: 0.9\n")
    limits, bright = load_limits(path), Bench(white=1.6)
    assert [one.cause for one in diagnose_frames(bright.recording())] == [SATURATED]
    assert SATURATED not in [one.cause for one in diagnose_frames(bright.recording(), limits=limits)]
    _, _, found = measured(bright, limits)
    assert found.summary()["limits"] == {"exposure": {"max_saturated_share": 0.9}}
    save_diagnosis(found, tmp_path)
    kept = load_diagnosis(tmp_path)
    assert kept is not None
    assert kept.diagnosis().changed_limits == {"exposure": {"max_saturated_share": 0.9}}
    assert "limits" not in measured(Bench())[2].summary()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("exposures: {}\n", r"there is no section 'exposures'; there are acceptance_test, .*ambient, "),
        ("exposure:\n  max_saturated: 0.9\n", r"exposure: unknown key 'max_saturated'"),
        ("exposure:\n  max_saturated_share: 1.5\n", r"exposure: 'max_saturated_share' is 1\.5"),
        ("exposure:\n  max_saturated_share: none\n", r"exposure: 'max_saturated_share' is 'none'"),
        ("- 1\n", r"must have sections of limits, of acceptance_test"),
    ],
)
def test_what_is_no_limit_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        load_limits(path)
