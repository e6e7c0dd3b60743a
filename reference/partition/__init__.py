"""How a scene is cut into blocks, and which points and views a block gets."""
