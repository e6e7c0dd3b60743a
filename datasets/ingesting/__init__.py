"""From a folder of photos to a scene folder: survey, structure from motion, GPS alignment."""
