"""What command lines, files, figures and workers share."""
