"""The playground: one page on which three axes run in the browser, from the generated C."""
