"""The Killian Court recording: a robot with a laser scanner in the corridors of MIT."""
