"""What each command does, given its typed config; `tf_lab.cli.command` composes it."""
