"""The fit of the light: response, brightness, the room's lamp, and the contrast of fine fringes."""
