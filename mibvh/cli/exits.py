"""Exit codes other than 0."""

#: A user's mistake, or what the system refused.
REFUSED = 2
#: An audit failed.
AUDIT_FAILED = 3
#: Ctrl-C ended the command, as any program that it ends.
INTERRUPTED = 130
