# SPDX-License-Identifier: Apache-2.0
# What the tests of CMakeLists.txt leave out as it takes long: cmake/check.sh --all.

# The library for C, and a client that a C compiler compiles.
if(TARGET rye_c)
  target_sources(test_c PRIVATE c/client.c)
  set_source_files_properties(c/client.c PROPERTIES SKIP_PRECOMPILE_HEADERS ON COMPILE_OPTIONS
                              "-std=c11;-Wall;-Wextra;-Wconversion;-Wpedantic;-Werror")
  target_link_libraries(test_c PRIVATE rye_c)
  if(TARGET rye_device_emulated)
    target_link_libraries(test_c PRIVATE rye_device_emulated)
    rye_check(c_device_symbols c/symbols.sh $<TARGET_FILE:rye_device_emulated>
              ${include}/rye/c/device.h)
    rye_check(torch torch/torch.sh $<TARGET_FILE:rye_device_emulated>)
    set_tests_properties(torch PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 300)
  else()
    rye_not_run(c_device "check.sh --release runs it: rye/c/device.h by the emulation, and PyTorch")
  endif()
endif()

# Sources for imports, and the program that writes them for the commands of docs/results/importing.md.
if(TARGET test_importers)
  add_library(import_sources STATIC importers/comparison.cpp importers/sources.cpp importers/video_tracks_source.cpp
                                    importers/xgaze_source.cpp)
  target_link_libraries(import_sources PUBLIC rye_trainer)
  target_precompile_headers(import_sources REUSE_FROM rye_precompiled)
  if(TARGET rye_hdf5_headers)
    target_link_libraries(import_sources PRIVATE rye_hdf5_headers)
  endif()
  target_link_libraries(test_importers PRIVATE import_sources)
  add_executable(make_import_source importers/make_source.cpp)
  target_link_libraries(make_import_source PRIVATE import_sources)
  target_precompile_headers(make_import_source REUSE_FROM rye_precompiled)
  # ... and the differences of a video's capture from the truth, for docs/video.md.
  add_executable(video_truth importers/video_truth.cpp)
  target_link_libraries(video_truth PRIVATE rye_trainer)
  target_precompile_headers(video_truth REUSE_FROM rye_precompiled)
  add_executable(video_views importers/video_views.cpp)
  target_link_libraries(video_views PRIVATE rye_trainer)
  target_precompile_headers(video_views REUSE_FROM rye_precompiled)
endif()

# The gaze estimator on the photographs of a capture, for docs/results/evaluation.md.
if(TARGET test_evaluate)
  add_executable(gaze_of_photographs evaluate/photographs.cpp)
  target_link_libraries(gaze_of_photographs PRIVATE rye_trainer)
  target_precompile_headers(gaze_of_photographs REUSE_FROM rye_precompiled)
  # ... and how far expressions are known, for docs/results/experiments.md.
  add_executable(landmarks_of_expressions evaluate/expressions.cpp)
  target_link_libraries(landmarks_of_expressions PRIVATE rye_trainer)
  target_precompile_headers(landmarks_of_expressions REUSE_FROM rye_precompiled)
  # ... and how far labels are from others, for docs/results/evaluation.md.
  add_executable(wrong_labels evaluate/wrong_labels.cpp)
  target_link_libraries(wrong_labels PRIVATE rye_trainer)
  target_precompile_headers(wrong_labels REUSE_FROM rye_precompiled)
endif()

add_subdirectory(widths)

# ---- more checks that call the compiler themselves ---------------------------------------------
# A second for each of hundreds of headers; test_odr includes them all in two orders.
if(RYE_TESTS STREQUAL release)
  rye_check(headers_alone headers/alone.sh ${compiler} ${include} ${precompiled})
  set_tests_properties(headers_alone PROPERTIES PROCESSORS 2 FIXTURES_REQUIRED rye_precompiled)
else()
  rye_not_run(headers_alone "check.sh --release runs it")
endif()
# -march=native may have lanes of 512 bits, whose intrinsics of g++ 12 warn of themselves.
set(optimised)
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  set(optimised "-O3 -march=x86-64-v4")
endif()
rye_check(headers_warnings headers/warnings.sh ${compiler} ${PROJECT_SOURCE_DIR}/README.md
          ${CMAKE_CURRENT_BINARY_DIR}/warnings -O2 ${optimised})
rye_check(docstrings documents/doxygen.sh ${PROJECT_SOURCE_DIR}
          ${CMAKE_CURRENT_BINARY_DIR}/docstrings)
rye_check(site site/site.sh ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_BINARY_DIR}/site)
set_tests_properties(docstrings site PROPERTIES SKIP_RETURN_CODE 77)
if(NOT CMAKE_CXX_COMPILER_ID MATCHES Clang)
  find_program(RYE_CLANG NAMES clang++ clang++-14)
  if(RYE_CLANG)
    rye_check(headers_clang headers/clang.sh ${RYE_CLANG} ${CMAKE_CURRENT_BINARY_DIR}/compile_flags.txt
              ${CMAKE_CURRENT_BINARY_DIR}/all_headers.hpp)
  else()
    rye_not_run(headers_clang "no clang++ beside this compiler")
  endif()
endif()

rye_check(reject_without_faults reject/valid.sh ${compiler} ${CMAKE_CURRENT_BINARY_DIR}/reject)

if(TARGET rye_c AND UNIX AND NOT APPLE)
  rye_check(c_symbols c/symbols.sh $<TARGET_FILE:rye_c> ${include}/rye/c/rye.h)
  if(RYE_INSTALL)
    rye_check(c_installed c/installed.sh ${PROJECT_SOURCE_DIR} ${PROJECT_BINARY_DIR}
              ${CMAKE_COMMAND} ${CMAKE_GENERATOR})
  endif()
endif()

# ---- more of the program as a user runs it ------------------------------------------------------
if(TARGET rye_program)
  add_executable(bit_flips programs/bit_flips.cpp)
  target_link_libraries(bit_flips PRIVATE rye_test_tiny rye_test_flags)
  target_precompile_headers(bit_flips REUSE_FROM rye_test_support)
  add_test(NAME bit_flips COMMAND bit_flips)  # bit_flips 300: as many in each file
  set_tests_properties(bit_flips PROPERTIES TIMEOUT 300)
  rye_check(two_trainings programs/two_trainings.sh $<TARGET_FILE:rye_program>
            ${CMAKE_CURRENT_BINARY_DIR}/two_trainings)
  set_tests_properties(two_trainings PROPERTIES TIMEOUT 1200)
  # The program with an emulated device in the place of none: kernels of stage 2 run on the host.
  add_executable(rye_emulated ${PROJECT_SOURCE_DIR}/examples/trainer/main.cpp
                              programs/emulated_device.cpp programs/emulated_mesh.cpp)
  target_compile_options(rye_emulated PRIVATE -O3 -fno-strict-aliasing
                                               -ffp-contract=off)
  target_link_libraries(rye_emulated PRIVATE rye_trainer)
  rye_check(train_on_device programs/device.sh $<TARGET_FILE:rye_program>
            $<TARGET_FILE:rye_emulated> ${CMAKE_CURRENT_BINARY_DIR}/train_on_device)
  set_tests_properties(train_on_device PROPERTIES TIMEOUT 1800)
  rye_check(ranks programs/ranks.sh $<TARGET_FILE:rye_program> $<TARGET_FILE:rye_emulated>
            ${CMAKE_CURRENT_BINARY_DIR}/ranks)
  set_tests_properties(ranks PROPERTIES TIMEOUT 1200)
  rye_check(density programs/density.sh $<TARGET_FILE:rye_program> $<TARGET_FILE:rye_emulated>
            ${CMAKE_CURRENT_BINARY_DIR}/density)
  set_tests_properties(density PROPERTIES TIMEOUT 600)
  rye_check(appearance programs/appearance.sh $<TARGET_FILE:rye_program>
            ${CMAKE_CURRENT_BINARY_DIR}/appearance)
  set_tests_properties(appearance PROPERTIES TIMEOUT 600)
  if(TARGET lesson_11_draw_my_avatar)
    rye_check(lessons programs/lessons.sh $<TARGET_FILE:rye_program>
              $<TARGET_FILE:lesson_11_draw_my_avatar> ${CMAKE_CURRENT_BINARY_DIR}/lessons)
    set_tests_properties(lessons PROPERTIES TIMEOUT 1200)
  endif()
  rye_check(flaw programs/flaw.sh $<TARGET_FILE:rye_program> ${PROJECT_SOURCE_DIR}/docs/flaws.md
            ${CMAKE_CURRENT_BINARY_DIR}/flaw)
  set_tests_properties(flaw PROPERTIES TIMEOUT 600)
  rye_check(limits programs/limits.sh $<TARGET_FILE:rye_program> ${CMAKE_CURRENT_BINARY_DIR}/limits)
  set_tests_properties(limits PROPERTIES TIMEOUT 600)
  rye_check(travel programs/travel.sh $<TARGET_FILE:rye_program> ${CMAKE_CURRENT_BINARY_DIR}/travel)
  set_tests_properties(travel PROPERTIES TIMEOUT 600)
  rye_check(compare programs/compare.sh $<TARGET_FILE:rye_program> ${CMAKE_CURRENT_BINARY_DIR}/compare)
  set_tests_properties(compare PROPERTIES TIMEOUT 1200)
  if(RYE_TESTS STREQUAL release)
    rye_check(jobs jobs/jobs.sh $<TARGET_FILE:rye_program> ${CMAKE_CURRENT_BINARY_DIR}/jobs)
    set_tests_properties(jobs PROPERTIES PROCESSORS 2 TIMEOUT 1200)
    add_test(NAME streams COMMAND test_learning "-tc=streams*")
    set_tests_properties(streams PROPERTIES TIMEOUT 1200)
  else()
    rye_not_run(streams "check.sh --release runs it: trainings without one of the streams")
    rye_not_run(jobs "check.sh --release runs it, under Slurm and GNU parallel")
  endif()
  if(RYE_INSTALL)
    rye_check(shell_files programs/shell_files.sh $<TARGET_FILE:rye_program> ${PROJECT_BINARY_DIR}
              ${CMAKE_COMMAND} ${CMAKE_CURRENT_BINARY_DIR}/shell_files)
  endif()
  if(RYE_OPENMP AND TARGET OpenMP::OpenMP_CXX)
    rye_check(beside programs/beside.sh $<TARGET_FILE:rye_program>
              ${CMAKE_CURRENT_BINARY_DIR}/beside)
    set_tests_properties(beside PROPERTIES RUN_SERIAL ON TIMEOUT 600 SKIP_RETURN_CODE 77)
  endif()
  if(TARGET lesson_09_draw_from_c)
    rye_check(export_avatar programs/export_avatar.sh $<TARGET_FILE:rye_program>
              $<TARGET_FILE:lesson_09_draw_from_c> ${CMAKE_CURRENT_BINARY_DIR}/export_avatar)
    set_tests_properties(export_avatar PROPERTIES TIMEOUT 600)
  endif()
  # It measures how long frames take.
  rye_check(gaze_page gaze_page/gaze_page.sh $<TARGET_FILE:rye_program>
            ${CMAKE_CURRENT_BINARY_DIR}/gaze_page)
  set_tests_properties(gaze_page PROPERTIES RUN_SERIAL ON TIMEOUT 900 SKIP_RETURN_CODE 77)
  rye_check(gaze_dots importers/gaze_dots.sh $<TARGET_FILE:rye_program>
            ${PROJECT_SOURCE_DIR}/docs/gaze_dots.html ${CMAKE_CURRENT_BINARY_DIR}/gaze_dots)
  set_tests_properties(gaze_dots PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 300)
  if(TARGET video_truth)
    rye_check(video importers/video.sh $<TARGET_FILE:rye_program> $<TARGET_FILE:video_truth>
              ${CMAKE_CURRENT_BINARY_DIR}/video)
    set_tests_properties(video PROPERTIES PROCESSORS 2 TIMEOUT 1200 SKIP_RETURN_CODE 77)
    if(RYE_TESTS STREQUAL release)
      rye_check(video_kinds importers/video_kinds.sh $<TARGET_FILE:rye_program>
                ${CMAKE_CURRENT_BINARY_DIR}/video_kinds)
      set_tests_properties(video_kinds PROPERTIES PROCESSORS 2 TIMEOUT 1200 SKIP_RETURN_CODE 77)
    endif()
  endif()
  if(TARGET make_import_source)
    rye_check(avatar_of_video programs/avatar.sh $<TARGET_FILE:rye_program>
              $<TARGET_FILE:make_import_source> ${CMAKE_CURRENT_BINARY_DIR}/avatar_of_video)
    set_tests_properties(avatar_of_video PROPERTIES PROCESSORS 2 TIMEOUT 600)
  endif()
  rye_check(crash_safety programs/crash_safety.sh $<TARGET_FILE:rye_program>
            ${CMAKE_CURRENT_BINARY_DIR}/crash_safety)
  set_tests_properties(crash_safety PROPERTIES TIMEOUT 1200)
endif()

# ---- kernels for instructions that this machine may not have -------------------------------------
if(CMAKE_CXX_COMPILER_ID STREQUAL GNU AND CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  rye_check(headers_lanes headers/lanes.sh ${compiler} ${CMAKE_CURRENT_SOURCE_DIR})
endif()

# ---- the formulas that a device needs ---------------------------------------------------------------
add_executable(device_formulas_on_host device/formulas.cu)
set_source_files_properties(device/formulas.cu PROPERTIES LANGUAGE CXX)  # here; nvcc's in check.sh
target_link_libraries(device_formulas_on_host PRIVATE rye_test_flags)
add_test(NAME device_formulas_on_host COMMAND device_formulas_on_host)
if(RYE_TESTS STREQUAL release) # steps_device.cu, which device_programs compiles, has most of them
  rye_check(device_formulas device/check.sh ${CMAKE_CURRENT_BINARY_DIR}/compile_flags.txt)
  set_tests_properties(device_formulas PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 900)
else()
  rye_not_run(device_formulas "check.sh --release has nvcc compile every formula")
endif()

# ---- kernels of a device: their machine code everywhere that nvcc is; on a device they run --------
# Each architecture takes a minute and a half: release has all, and the others the newest.
set(architectures 90 90a)
if(RYE_TESTS STREQUAL release)
  set(architectures 75 80 90 90a)
else()
  rye_not_run(device_kernels_75_80 "check.sh --release runs it")
endif()
rye_check(device_kernels cuda/machine_code.sh ${CMAKE_CURRENT_BINARY_DIR}/compile_flags.txt
          ${CMAKE_CURRENT_SOURCE_DIR}/cuda/record.txt ${architectures})
set_tests_properties(device_kernels PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 1800)
set(programs)
if(RYE_TESTS STREQUAL release)
  set(programs all)
else()
  rye_not_run(device_tests_and_benchmarks "check.sh --release compiles them all")
endif()
rye_check(device_programs cuda/programs.sh ${CMAKE_CURRENT_BINARY_DIR}/compile_flags.txt ${programs})
set_tests_properties(device_programs PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 1800)
if(RYE_CUDA)
  # References whose products and sums round apart, as those of kernels: where an instruction fuses
  # them, the plain loops' float takes other samples at a cut.
  set(apart -ffp-contract=off)
  add_library(rye_device_references STATIC ${rye_test_references})
  target_link_libraries(rye_device_references PRIVATE rye_test_flags)
  target_compile_options(rye_device_references PRIVATE ${apart})
  foreach(name rasterizer_device networks_device avatar_device drawer_device labels_device
          steps_device)
    add_executable(${name} cuda/${name}.cu)
    target_link_libraries(${name} PRIVATE rye_cuda rye_device_references doctest::doctest)
    target_compile_options(${name} PRIVATE ${rye_host_flags} -Xcompiler=${apart})
    add_test(NAME ${name} COMMAND ${name})
  endforeach()
  # Eigen's Cholesky, which runs on the host.
  target_compile_options(labels_device PRIVATE $<$<COMPILE_LANGUAGE:CUDA>:-diag-suppress=20014>)
  add_test(NAME rasterizer_device_lost COMMAND rasterizer_device lost)
  set_tests_properties(rasterizer_device rasterizer_device_lost networks_device avatar_device
                       drawer_device labels_device steps_device
                       PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 600)
else()
  rye_not_run(rasterizer_device "configured without RYE_CUDA")
  rye_not_run(networks_device "configured without RYE_CUDA")
  rye_not_run(avatar_device "configured without RYE_CUDA")
  rye_not_run(drawer_device "configured without RYE_CUDA")
  rye_not_run(labels_device "configured without RYE_CUDA")
  rye_not_run(steps_device "configured without RYE_CUDA")
endif()

# ---- an effect that is off costs nothing, for each compiler there is ----------------------------
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  function(rye_zero_cost name)
    rye_check(zero_cost_${name} effects/zero_cost.sh ${ARGN}
              ${CMAKE_CURRENT_BINARY_DIR}/compile_flags.txt
              ${CMAKE_CURRENT_SOURCE_DIR}/effects/zero_cost.cpp ${zero_cost_effects})
    set_tests_properties(zero_cost_${name} PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 1800)
  endfunction()
  if(NOT RYE_TESTS STREQUAL release)
    set(zero_cost_effects LEFT_GAZE HEAD_SHADING)
    rye_not_run(zero_cost_of_every_effect "check.sh --release runs it")
  endif()
  rye_zero_cost(own_compiler ${CMAKE_CXX_COMPILER})
  if(RYE_CLANG AND RYE_TESTS STREQUAL release)
    rye_zero_cost(clang ${RYE_CLANG})
  elseif(RYE_CLANG)
    rye_not_run(zero_cost_clang "check.sh --release runs it")
  else()
    rye_not_run(zero_cost_clang "no clang++ beside this compiler")
  endif()
endif()

# ---- the same numbers as PyTorch, where there is one --------------------------------------------
find_program(RYE_PYTHON NAMES python3)
set(no_torch 1)
if(RYE_PYTHON)
  execute_process(COMMAND ${RYE_PYTHON} -c "import torch" RESULT_VARIABLE no_torch OUTPUT_QUIET
                  ERROR_QUIET)
endif()
foreach(name networks lpips)
  if(no_torch EQUAL 0 OR RYE_TESTS STREQUAL release)
    add_executable(parity_${name} parity/${name}.cpp)
    target_link_libraries(parity_${name} PRIVATE rye_test_flags)
  endif()
  if(no_torch EQUAL 0)
    add_test(NAME parity_${name}
             COMMAND ${RYE_PYTHON} ${CMAKE_CURRENT_SOURCE_DIR}/parity/${name}_torch.py
                     $<TARGET_FILE:parity_${name}> ${PROJECT_SOURCE_DIR}/cmake)
    set_tests_properties(parity_${name} PROPERTIES SKIP_RETURN_CODE 77)
  else()
    rye_not_run(parity_${name} "no python3 with PyTorch")
  endif()
endforeach()

# ---- more projects that use rye -------------------------------------------------------------------
if(RYE_INSTALL)
  set(program) # with it a lesson is compiled once more
  if(TARGET rye_program AND RYE_TESTS STREQUAL release)
    set(program $<TARGET_FILE:rye_program>)
  endif()
  set(ways find_package)
  if(RYE_TESTS STREQUAL release)
    list(APPEND ways fetch_content)
  else()
    rye_not_run(consumer_fetch_content "check.sh --release runs it")
  endif()
  foreach(way IN LISTS ways)
    rye_check(consumer_${way} consumer/consumer.sh ${way} ${PROJECT_SOURCE_DIR} ${PROJECT_BINARY_DIR}
              ${CMAKE_COMMAND} ${CMAKE_GENERATOR} ${CMAKE_CXX_COMPILER} ${program})
  endforeach()
  find_program(RYE_PKG_CONFIG pkg-config)
  if(RYE_PKG_CONFIG)
    rye_check(consumer_pkg_config consumer/consumer.sh pkg_config ${PROJECT_SOURCE_DIR}
              ${PROJECT_BINARY_DIR} ${CMAKE_COMMAND} ${CMAKE_GENERATOR} ${CMAKE_CXX_COMPILER})
  else()
    rye_not_run(consumer_pkg_config "no pkg-config")
  endif()
  if(RYE_TESTS STREQUAL release)
    rye_check(packages packaging/packages.sh ${PROJECT_SOURCE_DIR}
              ${CMAKE_CURRENT_BINARY_DIR}/packages ${CMAKE_COMMAND} ${CMAKE_GENERATOR}
              ${CMAKE_CXX_COMPILER})
    set_tests_properties(packages PROPERTIES SKIP_RETURN_CODE 77)
  else()
    rye_not_run(packages "check.sh --release runs it")
  endif()
  rye_check(release packaging/release.sh ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_BINARY_DIR}/release)
  set_tests_properties(release PROPERTIES SKIP_RETURN_CODE 77)
  rye_check(packages_of_nothing_built packaging/nothing_built.sh ${PROJECT_SOURCE_DIR}
            ${CMAKE_CURRENT_BINARY_DIR}/nothing_built ${CMAKE_COMMAND} ${CMAKE_GENERATOR}
            ${CMAKE_CXX_COMPILER})
  rye_check(consumer_versions consumer/versions.sh ${PROJECT_SOURCE_DIR} ${PROJECT_BINARY_DIR}
            ${CMAKE_COMMAND} ${CMAKE_GENERATOR} ${CMAKE_CXX_COMPILER})
endif()

# ---- any bytes before the readers of files --------------------------------------------------------
add_subdirectory(fuzz)

# ---- the longest first, so that two jobs end together on a machine that has not run them yet ------
get_property(rye_tests DIRECTORY PROPERTY TESTS)
set(cost 100)
foreach(name device_programs test_train_cuda train_on_device headers_alone test_capture_scene
             consumer_find_package device_kernels zero_cost_clang zero_cost_own_compiler pipeline
             compare packages density test_learning device_formulas test_evaluate crash_safety
             test_importers ranks test_widths)
  if(name IN_LIST rye_tests)
    set_tests_properties(${name} PROPERTIES COST ${cost})
  endif()
  math(EXPR cost "${cost} - 1")
endforeach()
