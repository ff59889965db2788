"""What a case does: functions of parameters and a seed that return rows, with nothing kept in between."""
