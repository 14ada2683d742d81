"""The study of the gap workflow: what it answers on simulated vehicles with something hidden."""
