# Completion of stressbot, and of ros2 where that is ours, in bash; sourced by tools/env.sh.
_stressbot_complete() {
    local IFS=$'\n'
    mapfile -t COMPREPLY < <(
        COMP_LINE=$COMP_LINE COMP_POINT=$COMP_POINT COMP_TYPE=$COMP_TYPE _ARGCOMPLETE=1 _ARGCOMPLETE_IFS=$'\n' _ARGCOMPLETE_SHELL=bash \
            _ARGCOMPLETE_COMP_WORDBREAKS=$COMP_WORDBREAKS _ARGCOMPLETE_SUPPRESS_SPACE=1 "$1" 8>&1 9>&2 1>/dev/null 2>&1
    )
    if [[ ${COMPREPLY-} =~ [=/:]$ ]]; then
        compopt -o nospace
    fi
}
complete -o default -o bashdefault -F _stressbot_complete stressbot
