"""How it looks: the scene, and the cameras in it."""
