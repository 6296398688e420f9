"""One module a public recording or file format; its docstring says what the files hold."""
