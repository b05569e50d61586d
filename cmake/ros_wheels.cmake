# Passed as CMAKE_PROJECT_INCLUDE when messages are built against the ROS 2 wheels; a native build never reads it.
#
# The CMake targets that the wheels export name the Python include folder of the machine that built them, which
# CMake refuses because it does not exist here. This drops such folders, once the package has found all its targets.

function(stressbot_drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  list(FILTER targets INCLUDE REGEX "__rosidl_generator_py$")
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(existing)
    foreach(directory IN LISTS directories)
      if(EXISTS "${directory}")
        list(APPEND existing "${directory}")
      endif()
    endforeach()
    set_property(TARGET ${target} PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${existing}")
  endforeach()
endfunction()

cmake_language(DEFER CALL stressbot_drop_missing_include_directories)
