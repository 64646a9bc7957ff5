"""The studio: a robot that a person drives, maps with and sends about, input by input."""
