// SPDX-License-Identifier: Apache-2.0
/// corrupt nan|infinite|flat FILE.npz ARRAY: damages one array of a file, for tests of errors.
/// nan and infinite replace its first number; flat gives it one dimension.
#include <cstring>
#include <iostream>
#include <limits>
#include <string>

#include <rye/io/npz.hpp>

namespace {

template <class T>
void put(rye::NpyArray& array, double value) {
    const T number = static_cast<T>(value);
    std::memcpy(array.bytes.data(), &number, sizeof number);
}

void spoil(const std::string& how, rye::NpyArray& array) {
    const double bad = how == "nan" ? std::numeric_limits<double>::quiet_NaN()
                                    : std::numeric_limits<double>::infinity();
    if (how == "flat") array.shape = {array.size()};
    else if (array.item_size == 8) put<double>(array, bad);
    else put<float>(array, bad);
}

} // namespace

int main(int count, char** words) {
    if (count != 4) {
        std::cerr << "usage: corrupt nan|infinite|flat FILE.npz ARRAY\n";
        return 2;
    }
    try {
        rye::NpzArrays arrays = rye::read_npz(words[2]);
        spoil(words[1], arrays.at(words[3]));
        rye::write_npz(words[2], arrays);
    } catch (const std::exception& e) {
        std::cerr << "corrupt: " << e.what() << "\n";
        return 1;
    }
    return 0;
}
