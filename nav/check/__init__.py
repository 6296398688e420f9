"""Is a recording what it is declared to be, and can it be navigated?"""
