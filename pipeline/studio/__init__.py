"""The studio: interactive sessions of a simulated robot, or of a bag, in the browser."""
