"""Guided characterisation: poses are asked for one at a time, each judged at once, until enough is known."""

from fpplab.setup.guide.attempts import GuidedRun, PoseAttempt
from fpplab.setup.guide.loop import GuidedSettings, guided_characterisation

__all__ = ["GuidedRun", "GuidedSettings", "PoseAttempt", "guided_characterisation"]
