"""Where the filter starts: one object a way to find the attitude, and the rule among them."""
