"""City-scale reconstruction: partition, train blocks apart, stitch, refine, compress."""
