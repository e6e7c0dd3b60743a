"""Voxel anchors that networks decode: what scaffold-gs and its relatives share."""
