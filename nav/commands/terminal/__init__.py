"""What commands say on the terminal while they work.

progress      a bar, or a line now and then
"""
