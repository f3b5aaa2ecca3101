"""What a simulation offers beyond the devices: Protocols, independent of any one simulation.

A rig's simulation (`fpplab.devices.rig.Rig.simulation`) has an ability if it has the Protocol's methods:
`isinstance(rig.simulation, Matchable)`. A bench of real instruments has no simulation.
"""
