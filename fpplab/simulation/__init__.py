"""What a simulation offers beyond the devices: a Protocol for each, and nothing of any one simulation.

A rig's simulation (`fpplab.devices.rig.Rig.simulation`) has an ability if it has the Protocol's methods:
`isinstance(rig.simulation, Matchable)`. A bench of real instruments has none of them.
"""
