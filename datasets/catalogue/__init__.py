"""The known scenes, how to get them, and how a scene of any kind is opened."""
