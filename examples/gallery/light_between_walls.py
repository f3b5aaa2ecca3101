"""Steps whose walls and floors light each other."""

from bench import show

show({"render": {"bounces": 3}, "material": {"reflectance": 0.95}}, item="steps", limit_um=100)
