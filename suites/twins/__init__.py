"""Components with several implementations, side by side: what `bench run speed` measures."""
