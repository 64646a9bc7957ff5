"""What `import turtlebag` offers: the steps of the command line as functions, their results, and parts."""
