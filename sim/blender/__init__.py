"""The Blender process: the only code that imports bpy. Start it with `sim.worker`, never import it."""
