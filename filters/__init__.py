"""Earth model, sensor models, strapdown mechanisation and the error-state filter."""
