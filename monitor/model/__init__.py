"""Step 5: one step of the ONNX model, and the card that describes it."""
