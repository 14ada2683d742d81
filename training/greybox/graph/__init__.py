"""The chain as an ONNX graph."""
