"""How well an agent does: held-out episodes, and the report of them."""
