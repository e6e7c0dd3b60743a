"""What methods of driving scenes share: time, sky, LiDAR, and checks of what a scene lacks."""
