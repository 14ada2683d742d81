"""Files in and out: bounded inputs, whole outputs, manifests, JSON."""
