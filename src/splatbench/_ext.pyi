"""Native CPU kernels of splatbench."""
