#include "on_device.hpp"

#include "cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("device: features as halves") {
    halves_drawn<KernelChannels<3>>(CudaDevice(), queue(), 3);
    halves_drawn<KernelChannels<16>>(CudaDevice(), queue(), 16);
    halves_drawn<KernelChannels<32>>(CudaDevice(), queue(), 27);
}
int main(int argc, char** argv) { return cases_on_device("try_device", argc, argv); }
