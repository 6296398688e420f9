"""What watches a running filter, and what is said of it: patience, sanity, heading, doubts."""
