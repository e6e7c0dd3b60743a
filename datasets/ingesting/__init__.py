"""Makes a scene folder from a folder of photos: survey, structure from motion, GPS alignment."""
