"""Looking at trained models: pictures from any camera, a page in the browser, films."""
