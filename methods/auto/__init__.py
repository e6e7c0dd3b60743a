"""Method auto: what a scene, this machine and a budget ask for, planned and trained."""
