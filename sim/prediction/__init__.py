"""What a measurement will give, predicted on a simulation, and how far a measurement is from that."""

from sim.prediction.discrepancy import Discrepancy
from sim.prediction.figures import MeasuredFigures, figures_of, median_figures
from sim.prediction.predict import Prediction, predict

__all__ = ["Discrepancy", "MeasuredFigures", "Prediction", "figures_of", "median_figures", "predict"]
