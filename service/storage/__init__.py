"""Files of jobs, in a folder or in a bucket."""
