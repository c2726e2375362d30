# SPDX-License-Identifier: Apache-2.0
# ryeVersions.cmake: the least versions of the libraries that rye's headers need. A version given to
# find_package would refuse newer major versions, with which rye works too.
set(rye_least_Eigen3 3.4)
set(rye_least_xsimd 8.1)

# Sets `out` to a sentence if a package that was found is too old, else to nothing.
function(rye_too_old package out)
  set(sentence "")
  if(DEFINED ${package}_VERSION AND ${package}_VERSION VERSION_LESS rye_least_${package})
    set(sentence "rye: found ${package} ${${package}_VERSION} in ${${package}_DIR}, expected")
    string(APPEND sentence " ${rye_least_${package}} or newer")
  endif()
  set(${out} "${sentence}" PARENT_SCOPE)
endfunction()
