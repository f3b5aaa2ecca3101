"""The artefacts and standards, one per file; a file's name is the artefact's name.

To add an artefact, add a file here with one subclass of `fpplab.artefacts.base.Artefact`: it is found by
listing this package (`fpplab.artefacts.catalogue`). The three artefacts that come with fpplab each test
another property of a measurement: the pyramid inclined faces (four orientations, two slopes), the pillars
shadows and small features at different heights, the steps plateaus and jumps in depth. The pyramid's faces
are smooth, since plateaus are covered by the steps. All three suit a camera field of about 169 x 112 mm.
"""
