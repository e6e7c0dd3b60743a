"""Scenes made by the package itself: ray-cast meshes whose images, depth and objects are exact."""
