"""The statistics of the DDIA-VE paper, for any drive: samples, pairs, tables, figures."""
