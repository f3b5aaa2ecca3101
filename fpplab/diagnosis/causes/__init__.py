"""Causes of a diagnosis, a module each; those that only other stages of work report share one per stage.

A module holds all there is of its cause: limits, detectors, what else it brings about, what makes a result
useless, remedy, documentation and picture. `fpplab.diagnosis.catalogue` finds the modules by listing this
package.
"""
