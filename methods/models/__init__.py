"""What training leaves behind: kinds of models, how they are saved, loaded and rendered."""
