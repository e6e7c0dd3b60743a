"""What is stored of a model: spectra, gates, codes and the file."""
