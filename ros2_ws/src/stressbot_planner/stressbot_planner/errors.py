"""Why an input was refused or a plan was not found."""

from stressbot_msgs.errors import ErrorCode as ErrorCode
from stressbot_msgs.errors import StressbotError as StressbotError
from stressbot_msgs.wording import quoted as quoted
