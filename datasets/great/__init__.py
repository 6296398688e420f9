"""The GREAT dataset of Wuhan University: files, installation, import, reader, and a writer."""
