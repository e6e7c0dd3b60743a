"""Study speed: time, memory and error of everything that has a twin."""
