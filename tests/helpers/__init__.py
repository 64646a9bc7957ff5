"""What the tests of several folders use; what those of one use lies in that folder."""
