"""Components with several implementations, side by side: what `bench study speed` measures."""
