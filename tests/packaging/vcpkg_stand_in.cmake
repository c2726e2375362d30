# SPDX-License-Identifier: Apache-2.0
# cmake -DPORT= -DCURRENT_PACKAGES_DIR= -DBUILD= -DGENERATOR= -DCXX= -P: runs a port of vcpkg with the
# CMake commands that vcpkg's functions come down to for headers: configure, install, and the package
# configuration moved to share/<port>, where vcpkg wants it.
set(VCPKG_TARGET_TRIPLET stand-in)
macro(run)
  execute_process(COMMAND ${ARGN} COMMAND_ERROR_IS_FATAL ANY)
endmacro()
function(vcpkg_cmake_configure)
  cmake_parse_arguments(ask "" "SOURCE_PATH" "OPTIONS" ${ARGN})
  run(${CMAKE_COMMAND} -S ${ask_SOURCE_PATH} -B ${BUILD} -G ${GENERATOR} -DCMAKE_CXX_COMPILER=${CXX}
      -DCMAKE_INSTALL_PREFIX=${CURRENT_PACKAGES_DIR} ${ask_OPTIONS})
endfunction()
function(vcpkg_cmake_install)
  run(${CMAKE_COMMAND} --build ${BUILD})
  run(${CMAKE_COMMAND} --install ${BUILD})
endfunction()
function(vcpkg_cmake_config_fixup)
  cmake_parse_arguments(ask "" "CONFIG_PATH" "" ${ARGN})
  file(COPY ${CURRENT_PACKAGES_DIR}/${ask_CONFIG_PATH}/ DESTINATION ${CURRENT_PACKAGES_DIR}/share/rye)
  file(REMOVE_RECURSE ${CURRENT_PACKAGES_DIR}/${ask_CONFIG_PATH})
endfunction()
function(vcpkg_fixup_pkgconfig)
endfunction()
function(vcpkg_install_copyright)
  cmake_parse_arguments(ask "" "" "FILE_LIST" ${ARGN})
  file(READ ${ask_FILE_LIST} text)
  file(WRITE ${CURRENT_PACKAGES_DIR}/share/rye/copyright "${text}")
endfunction()
# A port knows its folder; included from here it would be this one's.
file(READ ${PORT}/portfile.cmake text)
string(REPLACE "\${CMAKE_CURRENT_LIST_DIR}" "${PORT}" text "${text}")
cmake_language(EVAL CODE "${text}")
