"""Decode a recorded session and plot what every camera pixel saw: `decode_and_plot.py SESSION OUT.png`."""

import sys

from matplotlib import pyplot as plt

from fpplab import Session, decode

session, out = sys.argv[1:]
decoded = decode(Session.open(session).recording())
print(f"{decoded.valid.sum()} of {decoded.valid.size} pixels measured")

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
figure.colorbar(left.imshow(decoded.u), ax=left, label="projector column, px")
figure.colorbar(right.imshow(decoded.sigma, vmax=0.05), ax=right, label="1-sigma, px")
figure.savefig(out)
